"""Thirty steps of a stranger through the studio, on one page, and at the end in the browser of somebody else."""

import numpy as np
import pytest
from PIL import Image

from t2m_jax.motion.changes import Changes, path_from_text
from t2m_jax.motion.formats import load_motion
from tests.export.test_viewer import browser  # noqa: F401 - a fixture
from tests.serving.test_page import (  # noqa: F401 - fixtures
    WALK,
    WAVE,
    download,
    expect,
    generate,
    num_frames,
    open_studio,
    serious_faults,
    stage_picture,
)
from tests.serving.test_stranger import BOW, replace_second

pytestmark = pytest.mark.release
TURN = "a person turns around"
ROW = 8
"""Frames of a row of codes of the demo model."""


def drag(page, element, *, by: float) -> None:
    """Drags the middle of an element to the right, in pixels."""
    box = element.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + by / 2, y)
    page.mouse.move(x + by, y)
    page.mouse.up()


def draw(page, *points: tuple[float, float]) -> None:
    """Draws a line through points of the stage, which are shares of its width and height."""
    box = page.locator("#stage").bounding_box()
    places = [(box["x"] + x * box["width"], box["y"] + y * box["height"]) for x, y in points]
    page.mouse.move(*places[0])
    page.mouse.down()
    for place in places[1:]:
        page.mouse.move(*place, steps=8)
    page.mouse.up()


def write_and_replace(page) -> None:
    """Steps 1 to 5: write, generate, add a sentence, choose it, replace it."""
    page.get_by_role("spinbutton", name="Seconds").fill("2")
    generate(page, WALK)
    generate(page, WALK, WAVE, takes=2)
    replace_second(page)
    expect(page.locator(".take")).to_have_count(3)


def edit_the_timeline(page) -> None:
    """Steps 6 to 12: drag an end, use its keys, insert, split, give a length, undo and redo."""
    blocks, handle = page.locator(".block"), page.get_by_role("slider", name="Length of sentence 1")
    before = num_frames(page)
    drag(page, handle, by=150)
    expect(page.locator(".take")).to_have_count(4, timeout=60_000)
    expect(blocks).to_have_text([WALK, BOW])
    longer = num_frames(page)
    assert longer > before
    handle.focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Enter")
    expect(page.locator(".take")).to_have_count(5, timeout=60_000)
    assert num_frames(page) == longer - 2 * ROW
    blocks.nth(1).click()
    page.get_by_role("radio", name="Insert").check(force=True)
    page.get_by_role("textbox", name="Sentence").fill(TURN)
    page.get_by_role("spinbutton", name="Seconds").fill("1.2")
    page.keyboard.press("Enter")
    expect(blocks).to_have_text([WALK, TURN, BOW], timeout=60_000)
    assert num_frames(page) == longer - 2 * ROW + 24
    blocks.nth(1).click()
    page.get_by_role("spinbutton", name="Sentence length").fill("1.6")
    page.keyboard.press("Enter")
    expect(page.locator(".take")).to_have_count(7, timeout=60_000)
    assert num_frames(page) == longer - 2 * ROW + 32
    blocks.nth(0).click()
    page.keyboard.press("Shift+ArrowRight")
    page.get_by_role("button", name="Split", exact=True).click()
    expect(blocks).to_have_text([WALK, WALK, TURN, BOW])
    page.get_by_role("button", name="Undo", exact=True).click()
    expect(blocks).to_have_text([WALK, TURN, BOW])
    page.get_by_role("button", name="Redo", exact=True).click()
    expect(blocks).to_have_text([WALK, WALK, TURN, BOW])
    assert serious_faults(page) == []


def draw_a_path(page, tmp_path) -> None:
    """Steps 13 to 16: draw a path, show the motion on it, and undo twice."""
    before = load_motion(download(page, "NPZ", tmp_path))
    page.locator("#changes summary").click()
    page.get_by_role("button", name="Draw the path on the ground").click()
    draw(page, (0.5, 0.55), (0.62, 0.6), (0.7, 0.75))
    path = page.get_by_role("textbox", name="Path in meters").input_value()
    assert len(path_from_text(path)) >= 2
    assert serious_faults(page) == []
    page.get_by_role("button", name="Show the changed motion").click()
    expect(page.locator(".take-meta").first).to_contain_text("changed")
    drawn = load_motion(download(page, "NPZ", tmp_path))
    # The same as `--path` gives.
    np.testing.assert_allclose(drawn.positions, Changes(path=path_from_text(path)).apply(before).positions, atol=1e-5)
    page.locator("h1").click()
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    expect(page.locator(".block")).to_have_text([WALK, TURN, BOW])
    page.keyboard.press("Control+Shift+z")
    page.keyboard.press("Control+Shift+z")
    expect(page.locator(".take-meta").first).to_contain_text("changed")
    np.testing.assert_array_equal(load_motion(download(page, "NPZ", tmp_path)).positions, drawn.positions)


def order_the_history(page) -> None:
    """Steps 17 to 22: rename, duplicate, delete and take it back, compare in one view, and come back."""
    page.keyboard.press("n")
    page.get_by_role("textbox", name="Name").fill("my motion")
    page.keyboard.press("Enter")
    expect(page.locator("#take-title")).to_have_text("my motion")
    page.get_by_role("button", name="Duplicate", exact=True).click()
    expect(page.locator("#take-title")).to_have_text("my motion (copy)")
    count = page.locator(".take").count()
    page.get_by_role("button", name="Delete my motion (copy)").click()
    expect(page.locator(".take")).to_have_count(count - 1)
    page.get_by_role("button", name="Compare my motion", exact=True).click()
    page.get_by_role("button", name=f"Compare {WALK}", exact=True).click()
    expect(page.locator("#take-title")).to_have_text("Comparison")
    apart = stage_picture(page)
    page.get_by_role("button", name="In one view").click()
    expect(page.get_by_role("button", name="In one view")).to_have_attribute("aria-pressed", "true")
    assert np.any(apart != stage_picture(page))
    assert serious_faults(page) == []
    page.locator(".take-open").filter(has_text="my motion").click()
    expect(page.locator("#take-title")).to_have_text("my motion")
    page.reload()
    expect(page.locator("#take-title")).to_have_text("my motion")


def take_it_home(page, tmp_path) -> None:
    """Steps 23 to 26: look at the keys, fill the screen, and take a GIF of one sentence that goes around the figure."""
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Keys")).to_contain_text("split the sentence")
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog", name="Keys")).to_be_hidden()
    page.keyboard.press("m")
    expect(page.get_by_role("radio", name="GIF")).to_be_hidden()
    page.keyboard.press("m")
    page.locator(".block").nth(2).click()
    page.get_by_role("radio", name="GIF").check(force=True)
    page.get_by_role("combobox", name="Camera").select_option("turntable")
    with Image.open(download(page, "GIF", tmp_path)) as picture:
        assert picture.n_frames == 32
    page.get_by_role("button", name="Whole motion").click()


def share_and_open(page, open_studio, tmp_path) -> None:  # noqa: F811
    """Steps 27 to 30: share, open the link in another browser, download a GLB there, and open it again."""
    ours = load_motion(download(page, "NPZ", tmp_path))
    page.get_by_role("button", name="Share", exact=True).click()
    link = page.get_by_role("textbox", name="Link").input_value()
    other = open_studio(path=link.removeprefix(page.url))
    expect(other.locator(".take-meta").first).to_contain_text("changed", timeout=120_000)
    theirs = load_motion(download(other, "NPZ", tmp_path))
    np.testing.assert_array_equal(theirs.positions, ours.positions)
    other.locator("#file-input").set_input_files(download(other, "GLB", tmp_path))
    expect(other.locator(".take-meta").first).to_contain_text("file")
    assert num_frames(other) == ours.num_frames
    assert serious_faults(other) == []


def test_thirty_steps_of_a_stranger(open_studio, tmp_path):  # noqa: F811
    page = open_studio()
    write_and_replace(page)
    edit_the_timeline(page)
    draw_a_path(page, tmp_path)
    order_the_history(page)
    take_it_home(page, tmp_path)
    share_and_open(page, open_studio, tmp_path)
