"""The page of the studio in a browser that shows nothing on a screen, with a real server and the demo model."""

import dataclasses
import io
import re
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from axe_playwright_python import sync_playwright as axe
from PIL import Image

from t2m_jax.motion.changes import Changes
from t2m_jax.motion.formats import load_motion
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.targets import distances, read_target, targets_from_text
from t2m_jax.serving.schema import FileParameters, MotionBody
from tests.export.conftest import NASTY_CAPTION, walk  # noqa: F401 - a fixture
from tests.export.test_viewer import browser, wait_until  # noqa: F401 - a fixture

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
expect = playwright.expect
WAIT = 30_000
"""Milliseconds in which a page must do something, on a machine whose cores draw and run other tests."""
expect.set_options(timeout=WAIT)

pytestmark = pytest.mark.slow
WIDE, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}
WALK, WAVE = "a person walks forward", "a person waves with the left hand"


@pytest.fixture
def open_studio(browser, address):  # noqa: F811
    """Returns a function that opens the page; afterwards nothing may have gone wrong in it."""
    contexts, troubles, expected = [], [], []

    def open_page(*, viewport=WIDE, may_fail=(), path="", beside=None, **options):
        """Opens the page in a new profile, or in another tab `beside` a page."""
        expected.extend(may_fail)
        if beside is None:
            contexts.append(browser.new_context(viewport=viewport, **({"reduced_motion": "reduce"} | options)))
        context = contexts[-1] if beside is None else beside.context
        context.set_default_timeout(WAIT)
        page = context.new_page()
        page.on("console", lambda message: troubles.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on("request", lambda request: troubles.append(request.url) if not is_own(request.url) else None)
        page.goto(address + path)
        expect(page.locator("#examples button").first).to_be_visible()
        return page

    def is_own(url):
        return url.startswith((address, "data:", f"blob:{address}"))

    yield open_page
    for context in contexts:
        context.close()
    assert [trouble for trouble in troubles if not any(part in trouble for part in expected)] == []


def generate(page, *sentences, samples=1, takes=1):
    """Makes a motion, and waits until the history has so many takes."""
    page.get_by_role("combobox", name="Samples").select_option(str(samples))
    page.get_by_role("textbox", name="Seed").fill("7")
    page.get_by_role("textbox", name="Sentence").first.fill(sentences[0])
    for number, sentence in enumerate(sentences[1:], start=2):
        page.locator("#add-sentence").click()
        page.get_by_role("textbox", name=f"Sentence {number}").fill(sentence)
    if len(sentences) > 1:
        page.keyboard.press("Enter")
    else:
        page.get_by_role("button", name="Generate", exact=True).click()
    expect(page.locator(".take")).to_have_count(takes, timeout=180_000)


def open_two_sentences(page, walk, folder):  # noqa: F811
    """Opens a file with two sentences: to make one takes the server much longer."""
    parts = {"part_starts": (0, 40), "part_captions": (WALK, WAVE)}
    Motion(walk.positions, 20.0, **parts).save(folder / "two.npz")
    page.locator("#file-input").set_input_files(folder / "two.npz")
    expect(page.locator(".block")).to_have_text([WALK, WAVE])


def stage_picture(page) -> np.ndarray:
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return np.asarray(Image.open(io.BytesIO(page.locator("#stage").screenshot())).convert("RGB"), int)


def download(page, format_name, tmp_path) -> Path:
    page.get_by_role("radio", name=format_name).check(force=True)
    with page.expect_download(timeout=90_000) as info:
        page.get_by_role("button", name=f"Download {format_name}").click()
    path = tmp_path / info.value.suggested_filename
    info.value.save_as(path)
    return path


def num_frames(page) -> int:
    """Returns the number of frames of the selected motion, as the page tells it."""
    facts = page.locator("#take-facts").text_content()
    return int(facts.split(" frames")[0].split(" ")[-1])


def test_a_sentence_becomes_a_figure_that_moves(open_studio):
    page = open_studio(reduced_motion="no-preference")
    page.get_by_role("textbox", name="Sentence").fill(WALK)
    page.keyboard.press("Enter")
    expect(page.locator("#take-title")).to_have_text(WALK, timeout=60_000)
    expect(page.locator("#take-facts")).to_contain_text("seed")
    before = stage_picture(page)
    wait_until(page, "Number(document.getElementById('scrub').value) > 4")
    assert np.mean(np.abs(before - stage_picture(page)).max(axis=-1) > 16) > 0.002
    page.get_by_role("button", name="Reuse seed").click()
    assert page.get_by_role("textbox", name="Seed").input_value() in page.locator("#status").text_content()


def test_the_timeline_scrubs_and_trims(open_studio, tmp_path):
    page = open_studio()
    generate(page, WALK)
    expect(page.get_by_role("button", name="Play")).to_be_visible()  # the user asked for less motion
    frames = num_frames(page)
    first = stage_picture(page)
    page.get_by_role("slider", name="Frame", exact=True).fill("8")
    expect(page.locator("#clock")).to_contain_text("frame 8")
    assert np.any(first != stage_picture(page))
    page.locator("#stage-frame").click(position={"x": 5, "y": 5})
    page.keyboard.press("[")
    page.get_by_role("slider", name="End of the span").focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#begin")).to_have_value("0.40")
    assert load_motion(download(page, "NPZ", tmp_path)).num_frames == frames - 8 - 2
    page.get_by_role("spinbutton", name="Begin").fill("0.2")
    page.keyboard.press("Tab")
    expect(page.get_by_role("slider", name="Begin of the span")).to_have_attribute("aria-valuenow", "0.20")
    page.get_by_role("button", name="Whole motion").click()
    expect(page.locator("#begin")).to_have_value("0.00")
    handle = page.locator("#begin-handle").bounding_box()
    page.mouse.move(handle["x"] + 6, handle["y"] + 8)
    page.mouse.down()
    page.mouse.move(handle["x"] + 150, handle["y"] + 8)
    page.mouse.up()
    assert float(page.locator("#begin").input_value()) > 0


@pytest.mark.release
def test_sentences_follow_each_other_and_a_part_is_made_again(open_studio):
    page = open_studio()
    generate(page, WALK, WAVE)
    blocks = page.locator(".block")
    expect(blocks).to_have_text([WALK, WAVE])
    frames = num_frames(page)
    blocks.nth(1).click()
    page.get_by_role("radio", name="Redo part").check(force=True)
    expect(page.get_by_role("textbox", name="Sentence")).to_have_value(WAVE)
    generate(page, "a person bows politely", samples=2, takes=2)
    assert num_frames(page) == frames and "1 of 2" in page.locator("#take-facts").text_content()
    page.keyboard.press("Tab")
    page.locator("h1").click()
    page.keyboard.press("2")
    expect(page.locator("#take-facts")).to_contain_text("2 of 2")
    page.get_by_role("button", name="Keep only this one").click()
    expect(page.locator(".take")).to_have_count(3)
    page.locator("#then").click()
    generate(page, WALK, takes=4)
    assert num_frames(page) > frames
    page.get_by_role("radio", name="Vary").check(force=True)
    page.get_by_role("button", name="Generate", exact=True).click()
    expect(page.locator(".take")).to_have_count(5, timeout=60_000)


def test_files_for_download_can_be_read(open_studio, tmp_path):
    page = open_studio()
    generate(page, WAVE)
    frames = num_frames(page)
    for name in ("GLB", "BVH", "VRMA"):
        motion = load_motion(download(page, name, tmp_path))
        assert motion.num_frames == frames and motion.positions.shape[1] == 22
    video = download(page, "MP4", tmp_path)
    assert imageio_ffmpeg.count_frames_and_secs(str(video))[0] >= frames
    page.locator("#file-input").set_input_files(next(tmp_path.glob("*.bvh")))
    expect(page.locator(".take")).to_have_count(2)
    expect(page.locator(".take-meta").first).to_contain_text("file")


def test_several_files_are_opened_and_the_shorter_of_two_ends_earlier(open_studio, walk, tmp_path):  # noqa: F811
    page = open_studio()
    for name, frames in {"short": 40, "long": 60}.items():
        Motion(walk.positions[:frames], 20.0, caption=name).save(tmp_path / f"{name}.npz")
    page.locator("#file-input").set_input_files([tmp_path / "short.npz", tmp_path / "long.npz"])
    expect(page.locator(".take-caption")).to_have_text(["long", "short"])
    page.get_by_role("button", name="Compare long").click()
    page.get_by_role("button", name="Compare short").click()
    expect(page.locator(".stage-caption")).to_have_count(2)
    ends = {}
    for number in (0, 1):
        page.locator(".stage-caption").nth(number).click()
        ends[page.locator(".stage-caption").nth(number).text_content()] = page.locator("#end").input_value()
    assert ends == {"A: long": "3.00", "B: short": "2.00"}
    # The key deletes the motion of the row, not the one that is shown.
    page.locator(".take-open").first.click()
    page.locator(".take-open").nth(1).focus()
    page.keyboard.press("Delete")
    expect(page.locator(".take-caption")).to_have_text(["long"])


def test_every_field_of_the_interface_has_a_control(open_studio):
    page = open_studio()
    controls = page.locator("[data-field]").evaluate_all("(all) => all.flatMap((e) => e.dataset.field.split(' '))")
    assert sorted(controls) == sorted({*MotionBody.model_fields, *FileParameters.model_fields})
    page.get_by_text("More options").click()
    given = {"Temperature": "0.5", "Top k": "20", "Seconds": "1.5"}
    for name, value in given.items():
        page.get_by_role("spinbutton", name=name).fill(value)
    page.get_by_role("checkbox", name="Not cleaned").check()
    sent = []
    page.on("request", lambda request: sent.append(request.post_data_json) if "/motions?" in request.url else None)
    generate(page, WALK)
    expected = {"temperature": 0.5, "top_k": 20, "seconds": 1.5, "raw": True, "seed": 7}
    assert sent == [expected | {"captions": [WALK], "num_samples": 1}] and num_frames(page) == 32
    page.get_by_role("combobox", name="Stop rule").select_option("argmax")
    page.get_by_role("spinbutton", name="Seconds").fill("")  # both exclude each other
    generate(page, WALK, takes=2)
    assert (sent[-1]["stop_rule"], "seconds" in sent[-1]) == ("argmax", False)
    page.get_by_role("spinbutton", name="Temperature").fill("2.1")
    page.get_by_role("button", name="Generate", exact=True).click()
    expect(page.get_by_role("alert")).to_contain_text("Temperature: ")


def drag(page, element, right, down):
    """Drags an element by some pixels."""
    box = element.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + right, y + down, steps=4)
    page.mouse.up()


def test_targets_are_dragged_in_the_picture(open_studio, tmp_path):
    page = open_studio()
    generate(page, WAVE)
    page.locator("#targets summary").click()
    field = page.get_by_role("textbox", name="As a text")
    page.get_by_role("slider", name="Frame", exact=True).fill("20")
    drag(page, page.locator("[data-joint=right_wrist]"), -20, -40)
    (target,) = targets_from_text(field.input_value())
    assert (target.joint, target.seconds) == ("right_wrist", 1.0)
    page.keyboard.press("ArrowUp")  # the handle has the focus
    (raised,) = targets_from_text(field.input_value())
    assert raised.place == pytest.approx(np.add(target.place, (0, 0.02, 0)))
    page.get_by_role("spinbutton", name="x, m").fill("-0.4")
    page.get_by_role("checkbox", name="Exact").check()
    page.get_by_role("slider", name="Time of target 1").press("ArrowRight")
    drag(page, page.locator("[data-joint=root]"), 20, 4)
    wrist, root = targets = targets_from_text(field.input_value())
    assert (wrist.place[0], wrist.seconds, wrist.exact, root.seconds) == (-0.4, 1.05, True, 1.0)
    generate(page, WAVE, takes=2)
    motion = load_motion(download(page, "NPZ", tmp_path))
    far = distances(motion, targets)
    assert far[0] < wrist.tolerance == 0.005 and far[1] < root.tolerance
    rows = page.locator(".target")
    expect(rows.first).to_contain_text("1.05 s · met, ")
    page.locator("h1").click()
    page.keyboard.press("Control+z")
    expect(page.locator(".take")).to_have_count(1)
    expect(rows).to_have_count(2)
    expect(rows.first).not_to_contain_text("met")
    page.keyboard.press("Control+z")
    expect(rows).to_have_count(1)
    page.keyboard.press("Control+Shift+z")
    page.get_by_role("button", name="Delete the target 1").click()
    expect(rows).to_have_text(re.compile("Root on the ground"))


@pytest.mark.release
def test_a_part_is_made_again_with_the_targets_in_it(open_studio, tmp_path):
    page = open_studio()
    generate(page, WALK)
    before = load_motion(download(page, "NPZ", tmp_path))
    page.get_by_role("spinbutton", name="Begin").fill("0.8")
    page.get_by_role("spinbutton", name="End").fill("2.4")
    page.get_by_role("radio", name="Redo part").check(force=True)
    page.locator("#targets summary").click()
    text = "0.2 head=0,1,0; 1.6 right_wrist+=-0.3,1.2,0.2"  # the first is in what stays
    page.get_by_role("textbox", name="As a text").fill(text)
    generate(page, WALK, takes=2)
    expect(page.locator(".target").nth(0)).not_to_contain_text(re.compile("met|missed"))
    expect(page.locator(".target").nth(1)).to_contain_text("1.60 s · met, ")
    after = load_motion(download(page, "NPZ", tmp_path))
    np.testing.assert_allclose(after.positions[:16], before.positions[:16], atol=1e-5)
    target = targets_from_text(text)[1]
    assert distances(after, [target])[0] < target.tolerance


# Keeps all that the notice says, because some of it is shown for a moment.
RECORD_NOTICES = """() => {
  window.notices = [];
  const box = document.getElementById("notice");
  new MutationObserver(() => notices.push(box.textContent)).observe(box, { childList: true });
}"""


def test_a_pose_of_a_file_becomes_a_key(open_studio, walk, tmp_path):  # noqa: F811
    page = open_studio()
    page.evaluate(RECORD_NOTICES)
    walk.save(tmp_path / "walk.npz")
    page.locator("#file-input").set_input_files(tmp_path / "walk.npz")
    expect(page.locator(".take")).to_have_count(1)
    expect(page.locator("#notice")).to_be_empty()
    assert page.evaluate("notices") == ["walk.npz is being opened …", ""]
    page.locator("#targets summary").click()
    page.get_by_role("slider", name="Frame", exact=True).fill("20")
    page.get_by_role("button", name="Pose as a key").click()
    page.get_by_role("spinbutton", name="Time, s").fill("0.5")
    page.keyboard.press("Tab")
    (target,) = targets_from_text(page.get_by_role("textbox", name="As a text").input_value())
    seconds = 20 / walk.fps
    assert target.seconds == 0.5 and distances(walk, [dataclasses.replace(target, seconds=seconds)])[0] < 0.002


@pytest.mark.release
def test_targets_are_met_or_said_to_be_missed(open_studio, tmp_path):
    page = open_studio(may_fail=["400"])
    page.locator("#targets summary").click()
    field = page.get_by_role("textbox", name="As a text")
    field.fill("0 root=0,0")
    generate(page, WAVE)
    motion = load_motion(download(page, "BVH", tmp_path))
    assert distances(motion, [read_target("0 root=0,0")])[0] < 0.01
    field.fill("0.2 left_wrist=0.6,1,0; 0.2 left_elbow=-0.6,1,0")  # farther apart than any forearm is long
    generate(page, WAVE, takes=2)
    expect(page.locator("#warning")).to_contain_text("misses left_wrist at 0.2 s by ")
    expect(page.locator(".target.missed").first).to_contain_text("0.20 s · missed by ")
    missed = page.get_by_role("button", name="Left wrist at 0.20 s, missed by ")
    red = missed.evaluate("(handle) => getComputedStyle(handle, '::after').backgroundImage")
    assert "rgb(194, 47, 24)" in red
    assert serious_faults(page) == []
    field.fill("0.2 nose=0,1,0")
    page.get_by_role("button", name="Generate", exact=True).click()
    expect(page.get_by_role("alert")).to_contain_text("nose at 0.2 s: no such joint")


def test_the_history_is_seen_and_has_pictures(open_studio):
    page = open_studio()
    generate(page, WAVE)
    generate(page, "a person sits down", takes=2)
    for row in (0, 1):
        expect(page.locator(".take").nth(row)).to_be_in_viewport(ratio=1)
    whole = "(name) => name.scrollWidth <= name.clientWidth && name.scrollHeight <= name.clientHeight"
    assert page.locator(".take-caption").first.evaluate(whole)
    pictures = page.locator(".take-picture path").evaluate_all("paths => paths.map((path) => path.getAttribute('d'))")
    sitting, waving = (np.array(re.findall(r"[-\d.]+", one), float).reshape(3, -1, 2) for one in pictures)
    # Three poses from left to right; one who sits has a lower head, so a larger y, at the end.
    for poses in (sitting, waving):
        assert (np.diff(poses[..., 0].mean(axis=1)) > 10).all() and 0 < poses[..., 1].min() < poses[..., 1].max() < 36
    assert sitting[2, :, 1].min() > sitting[0, :, 1].min() + 4


def test_a_motion_is_changed_in_the_preview_and_in_files(open_studio, tmp_path):
    page = open_studio(may_fail=["400"])
    generate(page, WAVE)
    before = load_motion(download(page, "NPZ", tmp_path))
    page.locator("#changes summary").click()
    page.get_by_role("checkbox", name="Mirrored").check()
    page.get_by_role("spinbutton", name="Speed factor").fill("2")
    written = load_motion(download(page, "NPZ", tmp_path))
    expected = Changes(mirror=True, speed=2.0).apply(before)
    assert written.caption == expected.caption == "a person waves with the right hand"
    np.testing.assert_allclose(written.positions, expected.positions, atol=1e-5)
    page.get_by_role("button", name="Show the changed motion").click()
    expect(page.locator("#take-title")).to_have_text(expected.caption)
    expect(page.locator(".take-meta").first).to_contain_text("changed")
    assert num_frames(page) == expected.num_frames
    shown = load_motion(download(page, "NPZ", tmp_path))  # the controls are as before, so nothing is changed twice
    np.testing.assert_allclose(shown.positions, expected.positions, atol=1e-5)
    page.get_by_role("textbox", name="Path in meters").fill("0,0")
    page.get_by_role("button", name="Download NPZ").click()
    expect(page.get_by_role("alert")).to_have_text(re.compile("^Path in meters: 1 point; give two or more"))


def test_the_history_survives(open_studio):
    page = open_studio()
    generate(page, WALK)
    generate(page, WAVE, samples=2, takes=2)
    page.reload()
    expect(page.locator(".take-caption")).to_have_text([WAVE, WALK])
    page.locator(".take-open").nth(1).click()
    expect(page.locator("#take-title")).to_have_text(WALK)
    page.get_by_role("button", name=f"Compare {WAVE}").click()
    expect(page.locator("#compare-hint")).to_contain_text(WAVE)
    page.get_by_role("button", name="Compare", exact=True).click()
    expect(page.locator("#take-title")).to_have_text("Comparison")
    expect(page.locator("#stage")).to_contain_text(f"A: {WAVE}")
    expect(page.locator("#stage")).to_contain_text(f"B: {WALK}")
    page.get_by_role("button", name=f"Delete {WALK}").click()
    expect(page.locator(".take")).to_have_count(1)
    page.get_by_role("button", name="Delete all").click()
    page.get_by_role("button", name="Delete", exact=True).click()
    expect(page.locator(".take")).to_have_count(0)
    page.reload()
    expect(page.locator("#history-empty")).to_be_visible()


def test_nothing_is_lost_if_something_fails(open_studio):
    page = open_studio(may_fail=["429", "503"])
    sentence, alert = page.get_by_role("textbox", name="Sentence"), page.get_by_role("alert")
    page.get_by_role("button", name="Generate", exact=True).click()
    expect(alert).to_have_text("Write a sentence first.")
    expect(sentence).to_be_focused()
    generate(page, WALK)
    sentence.fill(WAVE)
    answers = [(503, "the model restarts", "1"), (429, "too many requests", "1")]

    def answer(route):
        if not answers:
            route.continue_()
            return
        status, error, wait = answers.pop(0)
        route.fulfill(status=status, json={"error": error}, headers={"Retry-After": wait})

    page.route("**/motions?*", answer)
    sentence.press("Enter")
    expect(alert).to_have_text("the model restarts")
    expect(sentence).to_have_value(WAVE)
    expect(page.locator("#take-title")).to_have_text(WALK)
    sentence.press("Enter")
    expect(page.locator("#status")).to_have_text("The server is busy. Trying again in 1 s.")
    expect(page.locator("#take-title")).to_have_text(WAVE, timeout=60_000)
    expect(alert).to_be_empty()


def test_full_storage_is_told(open_studio):
    page = open_studio()
    page.evaluate("""() => {
      IDBObjectStore.prototype.put = () => { throw new DOMException("", "QuotaExceededError"); };
    }""")
    generate(page, WALK)
    expect(page.get_by_role("alert")).to_contain_text("storage is full")
    generate(page, WAVE, takes=2)
    page.locator(".take-open").nth(1).click()
    expect(page.locator("#take-title")).to_have_text(WALK)


TOKEN = "schl\u00fcssel"


def test_a_token_is_asked_for(open_studio):
    page = open_studio(may_fail=["401"])

    def answer(route):
        if route.request.headers.get("authorization") == f"Bearer {TOKEN}":
            route.continue_()
        else:
            route.fulfill(status=401, json={"error": "a token is needed"})

    page.route("**/model", answer)
    page.reload()
    refused = page.get_by_text("The server has refused this token.")
    expect(refused).to_be_hidden()
    page.locator("#token").fill("\u043f\u0430\u0440\u043e\u043b\u044c")  # another layout of the keyboard
    page.keyboard.press("Enter")
    expect(page.locator("#token")).to_have_value("")
    expect(refused).to_be_visible()
    assert serious_faults(page) == []
    page.locator("#token").fill(TOKEN)
    page.keyboard.press("Enter")
    expect(page.locator("#examples button").first).to_be_visible()
    page.goto(page.url + f"?token={TOKEN}")
    expect(page.locator("#examples button").first).to_be_visible()
    assert "token" not in page.url


def test_a_request_can_be_cancelled(open_studio):
    page = open_studio()
    page.route("**/motions?*", lambda route: None)
    sentence = page.get_by_role("textbox", name="Sentence")
    sentence.fill(WALK)
    page.get_by_role("button", name="Generate", exact=True).click()
    expect(page.get_by_role("button", name="Cancel")).to_be_focused()
    page.keyboard.press("Escape")
    expect(page.locator("#status")).to_have_text("Canceled.")
    expect(page.get_by_role("button", name="Generate", exact=True)).to_be_focused()
    expect(sentence).to_have_value(WALK)


def test_keys_and_help(open_studio):
    page = open_studio()
    generate(page, WALK, samples=2)
    page.locator("h1").click()
    page.keyboard.press("End")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Shift+ArrowLeft")
    expect(page.locator("#clock")).to_contain_text(f"frame {max(num_frames(page), 1) - 12}")
    page.keyboard.press("Space")
    expect(page.get_by_role("button", name="Pause")).to_be_visible()
    page.keyboard.press("Space")  # drawing on two busy cores leaves hardly any time for clicks
    expect(page.get_by_role("button", name="Play")).to_be_visible()
    page.keyboard.press("f")
    expect(page.get_by_role("button", name="Camera follows")).to_have_attribute("aria-pressed", "false")
    page.keyboard.press("?")
    expect(page.get_by_role("heading", name="Keys")).to_be_in_viewport()  # the dialog begins at its top
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog", name="Keys")).to_be_hidden()
    page.keyboard.press("/")
    expect(page.get_by_role("textbox", name="Sentence")).to_be_focused()
    page.get_by_text("Words that the model knows").click()
    page.get_by_role("searchbox", name="Filter words").fill("wav")
    page.get_by_role("group", name="Words").get_by_role("button", name="wave", exact=True).click()
    expect(page.get_by_role("textbox", name="Sentence")).to_have_value(f"{WALK} wave")


def test_captions_are_only_text(open_studio, walk, tmp_path):  # noqa: F811
    page = open_studio(viewport=PHONE)
    Motion(walk.positions, 20.0, caption=NASTY_CAPTION + " 😀" + "x" * 300).save(tmp_path / "nasty.npz")
    page.locator("#file-input").set_input_files(tmp_path / "nasty.npz")
    expect(page.locator(".take")).to_have_count(1)
    expect(page.locator("#take-title")).to_contain_text("😀")
    assert page.locator("img, main script").count() == 0
    assert page.evaluate("document.documentElement.scrollWidth") == PHONE["width"]


def test_a_seed_of_ten_digits_stays_on_one_line(open_studio, walk, tmp_path):  # noqa: F811
    page = open_studio(viewport=PHONE)
    Motion(walk.positions, 20.0, caption=WALK, seed=2**32 - 1).save(tmp_path / "long.npz")
    page.locator("#file-input").set_input_files(tmp_path / "long.npz")
    expect(page.locator("#take-facts")).to_contain_text("seed\u00a04294967295")
    lines = page.locator("#take-facts").evaluate("""(facts) => {
      const range = document.createRange();
      range.setStart(facts.firstChild, facts.textContent.indexOf("seed"));
      range.setEnd(facts.firstChild, facts.textContent.length);
      return new Set([...range.getClientRects()].map(({ top }) => top)).size;
    }""")
    assert lines == 1


@pytest.mark.parametrize("width", [1440, 768, 390])
def test_long_times_fit_in_their_fields(open_studio, walk, tmp_path, width):  # noqa: F811
    page = open_studio(viewport={"width": width, "height": 900})
    Motion(np.tile(walk.positions, (60, 1, 1)), 20.0, caption=WALK).save(tmp_path / "long.npz")
    page.locator("#file-input").set_input_files(tmp_path / "long.npz")
    expect(page.locator("#end")).to_have_value("240.00")
    page.locator("#sentence-length").evaluate("(field) => { field.value = '240.00'; }")
    cut = "(fields) => fields.filter((field) => field.scrollWidth > field.clientWidth).map(({ id }) => id)"
    assert page.locator(".trim input").evaluate_all(cut) == []


def test_phones_have_room_for_fingers(open_studio, walk, tmp_path):  # noqa: F811
    page = open_studio(viewport=PHONE, has_touch=True, is_mobile=True)
    open_two_sentences(page, walk, tmp_path)
    assert page.evaluate("document.documentElement.scrollWidth") == PHONE["width"]
    assert page.locator("#stage").bounding_box()["y"] < page.locator("#make").bounding_box()["y"]
    small = page.locator("button:visible:not(.chip), select:visible").evaluate_all(
        "(all) => all.filter((e) => e.getBoundingClientRect().height < 38).map((e) => e.id || e.textContent)"
    )
    assert small == []
    # The name of the colors is not cut.
    cut = page.locator("#theme").evaluate("""(select) => {
      const whole = select.cloneNode(true);
      whole.style.width = "max-content";
      select.parentElement.append(whole);
      return whole.offsetWidth - select.offsetWidth;
    }""")
    assert cut <= 0


@pytest.mark.parametrize(
    ("scheme", "viewport"), [pytest.param("light", WIDE, marks=pytest.mark.release), ("dark", PHONE)]
)
def test_accessibility(open_studio, walk, tmp_path, scheme, viewport):  # noqa: F811
    page = open_studio(viewport=viewport)
    page.get_by_role("combobox", name="Colors").select_option(scheme)
    page.get_by_role("textbox", name="Sentence").first.fill(WALK)
    open_two_sentences(page, walk, tmp_path)
    page.locator(".block").nth(1).click()
    page.get_by_text("Words that the model knows").click()
    assert serious_faults(page) == []
    page.get_by_role("combobox", name="Samples").select_option("8")
    page.get_by_role("button", name="Generate", exact=True).click()
    expect(page.locator("#take-facts")).to_contain_text("of 8", timeout=60_000)
    assert serious_faults(page) == []


def serious_faults(page) -> list:
    found = axe.Axe().run(page).response["violations"]
    serious = [fault for fault in found if fault["impact"] in ("serious", "critical")]
    return [(fault["id"], [node["target"] for node in fault["nodes"]]) for fault in serious]
