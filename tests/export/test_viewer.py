"""The viewer in a browser that shows nothing on a screen."""

import dataclasses
import io
import os
import shutil
import time

import numpy as np
import pytest
from PIL import Image

from t2m_jax.export.html import save_html, scene_record, viewer_html
from t2m_jax.export.render.scene import figure_from_motion
from t2m_jax.motion.motion import Motion
from tests.export.conftest import NASTY_CAPTION

pytestmark = pytest.mark.slow

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
SIZE = {"width": 420, "height": 360}
NO_WEBGL = "HTMLCanvasElement.prototype.getContext = () => null;"


@pytest.fixture(scope="module")
def browser():
    path = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("no Chromium found (CHROMIUM names one)")
    with playwright.sync_playwright() as running:
        chromium = running.chromium.launch(executable_path=path, headless=True, args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture
def open_viewer(browser, tmp_path):
    """Returns a function that opens motions in a page; afterwards nothing may have gone wrong in any of them."""
    contexts, troubles, expected = [], [], []

    def open_page(motions, *, script="", may_fail=(), animate=False, **options):
        path = tmp_path / "viewer.html"
        save_html(path, motions)
        motion = "no-preference" if animate else "reduce"
        context = browser.new_context(**({"viewport": SIZE, "reduced_motion": motion} | options))
        contexts.append(context)
        expected.extend(may_fail)
        context.add_init_script(script)
        page = context.new_page()
        page.on("console", lambda message: troubles.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on("dialog", lambda dialog: troubles.append(f"dialog: {dialog.message}"))
        page.on("request", lambda request: troubles.append(request.url) if request.url != path.as_uri() else None)
        page.goto(path.as_uri())
        wait_until(page, "window.t2mViewer !== undefined")
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert [trouble for trouble in troubles if not trouble.startswith(("data:", *expected))] == []


def picture(page) -> np.ndarray:
    """Returns what is seen above the controls, once it has been drawn."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    box = page.locator(".stage").bounding_box()
    shot = Image.open(io.BytesIO(page.screenshot(clip=box)))
    return np.asarray(shot.convert("RGB"), int)


def wait_until(target, condition: str) -> None:
    """Waits for a condition; `wait_for_function` would evaluate text in the page, which the page forbids."""
    end = time.monotonic() + 20
    while not target.evaluate(condition):
        assert time.monotonic() < end, condition
        time.sleep(0.03)


def changed(before: np.ndarray, after: np.ndarray) -> float:
    """Returns the share of pixels that differ visibly."""
    return float(np.mean(np.abs(before - after).max(axis=-1) > 16))


def viewer(page, expression: str):
    """Returns a property of the viewer."""
    return page.evaluate(f"window.t2mViewer.{expression}")


def test_a_figure_is_drawn_and_moves(open_viewer, walk):
    page = open_viewer([walk])
    assert viewer(page, "numFrames") == 80
    first = picture(page)
    red, _, blue = (first[..., channel] for channel in range(3))
    # The bluish left and the reddish right side; neither page nor ground has such colours.
    assert np.sum(blue - red > 40) > 200 and np.sum(red - blue > 40) > 200
    page.evaluate("window.t2mViewer.frame = 40")
    later = picture(page)
    assert changed(first, later) > 0.01
    page.evaluate("window.t2mViewer.frame = 0")
    assert changed(first, picture(page)) < 0.001
    page.mouse.move(200, 150)
    page.mouse.down()
    page.mouse.move(290, 120, steps=3)
    page.mouse.up()
    assert changed(first, picture(page)) > 0.01


def test_dark_pages_are_dark(open_viewer, walk):
    light, dark = (picture(open_viewer([walk], color_scheme=scheme)) for scheme in ("light", "dark"))
    assert light[-5:].mean() > 200 and dark[-5:].mean() < 60


def test_playing_and_pausing(open_viewer, walk):
    page = open_viewer([walk], animate=True)
    assert viewer(page, "playing") is True
    wait_until(page, "window.t2mViewer.frame > 2")
    page.keyboard.press("Space")
    assert viewer(page, "playing") is False
    stopped = viewer(page, "frame")
    page.wait_for_timeout(150)
    assert viewer(page, "frame") == stopped
    page.get_by_role("button", name="Play").click()
    wait_until(page, f"window.t2mViewer.frame !== {stopped}")
    page.get_by_role("button", name="Pause").click()
    assert viewer(page, "playing") is False
    page.get_by_label("Speed").select_option("2")
    assert viewer(page, "speed") == 2


def test_speed_is_the_rate_of_time(open_viewer, walk):
    page = open_viewer([walk])
    advanced = page.evaluate("""() => {
      const v = window.t2mViewer, passed = [];
      for (const speed of [0.25, 1, 2]) {
        v.frame = 0; v.speed = speed; v.playing = true;
        v.stage.last = 1000; v.stage.tick(1100); passed.push(v.frame); v.playing = false;
      }
      return passed;
    }""")
    assert advanced == pytest.approx([0.5, 2.0, 4.0])


def test_slow_pictures_become_lighter(open_viewer, walk):
    page = open_viewer([walk, walk], device_scale_factor=2)
    details = page.evaluate("""() => {
      const { stage } = window.t2mViewer, found = [];
      let now = 1000;
      for (const interval of [0.02, 0.2, 0.2, 0.2, 0.2]) {
        stage.running = true; stage.last = now;
        for (let k = 0; k < 8; k++) stage.tick(now += 1000 * interval);
        stage.running = false;
        stage.draw();
        found.push([stage.canvas.width / stage.canvas.clientWidth, stage.scenery.sun.castShadow]);
      }
      return found;
    }""")
    assert [shadow for _, shadow in details] == [True, True, True, False, False]
    assert [ratio for ratio, _ in details] == pytest.approx([2, 1, 0.75, 0.5, 0.5], abs=0.01)


def test_figures_share_what_is_drawn(open_viewer, walk):
    """A figure adds only its path and a line to the buffers, the same programs draw all, and all is given back."""
    page = open_viewer([walk])
    long = Motion(np.tile(walk.positions, (5, 1, 1)), 20.0)  # has more marks of feet than there was room for
    buffers, programs, pictures = [], [], []
    for motions in ([walk], [walk] * 4, [walk], [long]):
        page.evaluate("(scene) => window.t2mViewer.stage.show(scene)", scene_record(motions))
        page.evaluate("window.t2mViewer.stage.time = 19")
        pictures.append(picture(page))
        buffers.append(viewer(page, "stage.renderer.info.memory.geometries"))
        programs.append(viewer(page, "stage.renderer.info.programs.map(({ id }) => id)"))
    assert buffers == [buffers[0], buffers[0] + 3 * 2, buffers[0], buffers[0]]
    assert programs == [programs[0]] * 4
    new = open_viewer([long])
    new.evaluate("window.t2mViewer.stage.time = 19")
    assert changed(pictures[-1], picture(new)) == 0


def test_two_on_one_ground_are_in_one_picture(open_viewer, walk):
    """Both stand on it: in pictures at two places, the ground of one hid the feet of the other."""
    page = open_viewer([walk, walk])
    places = page.evaluate("""() => {
      const { stage } = window.t2mViewer, { renderer } = stage, places = [];
      stage.together = true;
      const place = renderer.setViewport;
      renderer.setViewport = (...box) => { places.push(box); place.call(renderer, ...box); };
      stage.draw();
      return places.slice(1); // the first one clears the canvas
    }""")
    assert len(places) == 2 and places[0] == places[1]


def test_limbs_reach_from_joint_to_joint(open_viewer, walk):
    """Also where they have another length than in the first frame, as decoded motions have."""
    long = np.array(walk.positions)
    elbow, hand = (walk.skeleton.joint_names.index(name) for name in ("left_elbow", "left_wrist"))
    long[1:, hand] += 2 * (long[1:, hand] - long[1:, elbow])
    page, later = open_viewer([Motion(long, 20.0)]), open_viewer([Motion(long[1:], 20.0)])
    page.evaluate("window.t2mViewer.frame = 1")
    assert changed(picture(page), picture(later)) == 0


def test_the_sentence_that_is_played_is_shown(open_viewer, walk):
    parts = {"part_starts": (0, 40), "part_captions": ("a person walks", "a person runs")}
    page = open_viewer([dataclasses.replace(walk, caption="a person walks, then a person runs", **parts)])
    said, height = [], set()
    for frame in (0, 39, 40, 79, 10):
        page.evaluate(f"window.t2mViewer.frame = {frame}")
        picture(page)
        said.append(page.locator(".stage-caption").text_content())
        height.add(page.locator(".stage-caption").bounding_box()["height"])
    assert said == ["a person walks", "a person walks", "a person runs", "a person runs", "a person walks"]
    assert len(height) == 1


def test_scrubbing_and_keys(open_viewer, walk):
    page = open_viewer([walk])
    first = picture(page)
    page.locator(".scrub").fill("40")
    assert viewer(page, "frame") == pytest.approx(40) and changed(first, picture(page)) > 0.01
    page.locator(".scrub").focus()
    for key, frame in (("ArrowRight", 41), ("Shift+ArrowRight", 51), ("ArrowLeft", 50), ("Home", 0), ("End", 79)):
        page.keyboard.press(key)
        assert viewer(page, "frame") == pytest.approx(frame)
    assert picture(page).shape == first.shape and page.locator(".scrub").input_value() == "79"
    page.keyboard.press("ArrowUp")
    assert viewer(page, "speed") == 1.5
    page.keyboard.press("f")
    assert viewer(page, "follow") is False
    wait_until(page, "document.querySelector('.follow').getAttribute('aria-pressed') === 'false'")


def test_mouse_orbits_pans_and_zooms(open_viewer, walk):
    page = open_viewer([walk])
    start, before = viewer(page, "camera"), picture(page)
    page.mouse.move(200, 150)
    page.mouse.wheel(0, -300)
    wait_until(page, f"window.t2mViewer.camera.zoom > {start['zoom']}")
    zoomed = picture(page)
    assert changed(before, zoomed) > 0.01
    page.keyboard.down("Shift")
    page.mouse.down()
    page.mouse.move(260, 170, steps=3)
    page.mouse.up()
    page.keyboard.up("Shift")
    now = viewer(page, "camera")
    assert now["yaw"] == start["yaw"] and np.linalg.norm(now["offset"]) > 0.05
    page.mouse.down()
    page.mouse.move(200, 150, steps=3)
    page.mouse.up()
    assert viewer(page, "camera")["yaw"] > start["yaw"] and viewer(page, "camera")["pitch"] < start["pitch"]
    page.get_by_role("button", name="Reset view").click()
    assert viewer(page, "camera") == start and changed(before, picture(page)) < 0.001


def test_fingers_orbit_and_pinch(open_viewer, walk):
    page = open_viewer([walk], has_touch=True)
    session = page.context.new_cdp_session(page)

    def touch(kind, *points):
        places = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})

    start = viewer(page, "camera")
    touch("touchStart", (200, 150))
    touch("touchMove", (150, 150))
    touch("touchEnd")
    wait_until(page, f"window.t2mViewer.camera.yaw > {start['yaw'] + 0.2}")
    turned = viewer(page, "camera")
    touch("touchStart", (180, 150), (220, 150))
    touch("touchMove", (140, 150), (260, 150))
    touch("touchEnd")
    wait_until(page, "window.t2mViewer.camera.zoom > 2")
    assert viewer(page, "camera.yaw") == turned["yaw"]


def test_captions_are_shown_letter_by_letter(open_viewer, nasty, walk):
    page = open_viewer([nasty])
    assert page.locator(".stage-caption").evaluate("(element) => element.textContent") == NASTY_CAPTION
    assert page.locator(".stage-caption").is_visible() and page.locator("img").count() == 0
    page = open_viewer([Motion(walk.positions, 20.0)])
    assert not page.locator(".stage-caption").is_visible()
    page = open_viewer([Motion(walk.positions, 20.0, caption="x" * 10_000)])
    assert page.locator(".stage-caption").bounding_box()["height"] < 0.5 * SIZE["height"]


def test_several_stand_side_by_side(open_viewer, walk, kit_walk, nasty):
    page = open_viewer([walk, kit_walk, nasty], viewport={"width": 900, "height": 420})
    picture(page)
    captions = page.locator(".stage-caption")
    assert captions.all_text_contents() == [walk.caption, kit_walk.caption, NASTY_CAPTION]
    boxes = [captions.nth(number).bounding_box() for number in range(3)]
    middles = [box["x"] + box["width"] / 2 for box in boxes]
    assert middles == sorted(middles) and middles[2] - middles[0] > 200
    assert all(box["x"] >= 0 and box["x"] + box["width"] <= 900 for box in boxes)
    assert viewer(page, "seconds") == pytest.approx(kit_walk.seconds)


def test_the_picture_follows_the_window(open_viewer, walk):
    page = open_viewer([walk], device_scale_factor=2)
    assert viewer(page, "stage.canvas.width") == 2 * SIZE["width"]
    page.set_viewport_size({"width": 300, "height": 500})
    wait_until(page, "window.t2mViewer.stage.canvas.width === 600")
    shot = picture(page)
    assert np.sum(shot[..., 2] - shot[..., 0] > 40) > 200


def test_the_camera_follows_unless_told_otherwise(open_viewer, walk):
    far = Motion(walk.positions + np.linspace(0, 30, 80, dtype=np.float32)[:, None, None] * np.float32([1, 0, 0]), 20.0)
    page = open_viewer([far])
    page.evaluate("window.t2mViewer.frame = 40")
    picture(page)
    following = seen_at(page)
    assert abs(following[0] - far.positions[40, 0, 0]) < 2.0
    page.get_by_role("button", name="Camera follows the figure").click()
    picture(page)
    standing = seen_at(page)
    page.evaluate("window.t2mViewer.frame = 79")
    picture(page)
    assert seen_at(page) == standing != following


def seen_at(page) -> list:
    """Returns the place between the camera and what it looks at, 4 m in front of it."""
    return viewer(
        page,
        """stage.cells.map(({ framing: { camera } }) => {
      const forward = camera.position.clone();
      return camera.getWorldDirection(forward).multiplyScalar(4).add(camera.position).toArray();
    })[0]""",
    )


def test_feet_leave_marks(open_viewer, walk):
    """The ground has a mark for each time that a foot stands, and the picture changes with them."""
    page = open_viewer([walk])
    expected = len(figure_from_motion(walk).contacts)
    assert expected >= 2 and viewer(page, "stage.cells[0].figure.contacts.length") == expected


def test_a_part_can_be_played_alone(open_viewer, walk):
    page = open_viewer([walk])
    passed = page.evaluate("""() => {
      const { stage } = window.t2mViewer, passed = [];
      stage.range = [1, 2]; stage.time = 1.9; stage.playing = true; stage.last = 1000;
      for (const now of [1050, 1200, 1300]) { stage.tick(now); passed.push(stage.time); }
      stage.playing = false; stage.range = null;
      return passed;
    }""")
    assert passed == pytest.approx([1.95, 1.0, 1.1])


def test_frames_can_follow(open_viewer, walk):
    """A motion that arrives in two parts is drawn as the whole one."""
    page = open_viewer([walk])
    page.evaluate("window.t2mViewer.frame = 60")
    whole = picture(page)
    head, tail = (scene_record([walk[part]])["figures"][0] for part in (slice(0, 40), slice(40, 80)))
    page.evaluate("(head) => window.t2mViewer.stage.show({ seconds: 2, figures: [head] })", head)
    assert viewer(page, "stage.seconds") == 2
    page.evaluate("(tail) => { t2mViewer.stage.extend(0, tail); t2mViewer.stage.time = 3; }", tail)
    assert viewer(page, "stage.seconds") == pytest.approx(4) and viewer(page, "stage.cells[0].figure.frames") == 80
    assert changed(whole, picture(page)) < 0.02
    page.evaluate("window.t2mViewer.stage.extend(3, null)")


def test_a_tap_selects_and_all_can_be_removed(open_viewer, walk):
    page = open_viewer([walk, walk], viewport={"width": 800, "height": 400})
    page.evaluate("() => { const { stage } = t2mViewer; stage.onselect = (number) => stage.select(number); }")
    page.mouse.click(600, 150)
    wait_until(page, "document.querySelectorAll('.selected').length === 1")
    assert page.locator(".selected").get_attribute("data-number") == "1"
    page.evaluate("window.t2mViewer.stage.dispose()")
    assert page.locator(".stage canvas, .stage-cell").count() == 0


@pytest.mark.release
@pytest.mark.parametrize("count", [6, 24])
def test_many_can_be_read_on_a_phone(open_viewer, walk, count):
    motions = [Motion(walk.positions, 20.0, caption=f"a person walks, take {number}") for number in range(count)]
    page = open_viewer(motions, viewport={"width": 390, "height": 844}, device_scale_factor=2)
    boxes = page.locator(".stage-picture").evaluate_all(
        "(all) => all.map((one) => one.getBoundingClientRect().toJSON())"
    )
    captions = page.locator(".stage-caption").evaluate_all(
        "(all) => all.map((one) => one.getBoundingClientRect().toJSON())"
    )
    assert all(box["width"] >= 100 and box["height"] >= 105 for box in boxes)
    for box, caption in zip(boxes, captions, strict=True):
        assert caption["top"] >= box["bottom"] - 0.5, "a caption covers a figure"
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    page.locator(".stage-cell").last.scroll_into_view_if_needed()
    shot = picture(page)
    assert np.sum(shot[..., 2] - shot[..., 0] > 40) > 200


@pytest.mark.release
def test_fingers_scroll_a_grid_that_is_too_high(open_viewer, walk):
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    page = open_viewer([walk] * 24, **phone)
    scroll(page, 600, 200)
    wait_until(page, "document.querySelector('.stage').scrollTop > 100")
    page = open_viewer([walk] * 6, **phone)
    before = viewer(page, "camera.pitch")
    scroll(page, 600, 400)
    assert viewer(page, "camera.pitch") < before  # there is nothing to scroll, so the camera moves


def scroll(page, begin: int, end: int) -> None:
    """Moves a finger up."""
    session = page.context.new_cdp_session(page)
    for place in range(begin, end, -80):
        kind = "touchStart" if place == begin else "touchMove"
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": 200, "y": place}]})
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def test_keys_move_the_camera(open_viewer, walk):
    page = open_viewer([walk])
    start = viewer(page, "camera")
    page.keyboard.press(".")
    page.keyboard.press("+")
    moved = viewer(page, "camera")
    assert moved["yaw"] != start["yaw"] and moved["zoom"] > start["zoom"]
    page.keyboard.press(",")
    page.keyboard.press("-")
    assert viewer(page, "camera.yaw") == pytest.approx(start["yaw"])


def test_one_frame_stands_still(open_viewer, walk):
    page = open_viewer([Motion(walk.positions[:1], 20.0)], animate=True)
    assert viewer(page, "numFrames") == 1 and viewer(page, "playing") is False
    assert len(np.unique(picture(page).reshape(-1, 3), axis=0)) > 200


def test_without_webgl_the_page_says_so(open_viewer, walk):
    page = open_viewer([walk], script=NO_WEBGL, may_fail=["THREE.WebGLRenderer"])
    assert "does not offer WebGL 2" in page.get_by_role("alert").text_content()


def test_notebooks_show_it_in_a_frame(browser, nasty):
    page = browser.new_page(viewport=SIZE, reduced_motion="reduce")
    page.set_content(viewer_html([nasty]))
    frame = page.frames[1]
    wait_until(frame, "window.t2mViewer !== undefined")
    assert frame.locator(".stage-caption").evaluate("(element) => element.textContent") == NASTY_CAPTION
    page.close()
