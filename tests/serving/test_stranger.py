"""The steps of somebody who sees the studio for the first time: from a sentence to a file, and what may go wrong."""

import numpy as np
import pytest

from t2m_jax.motion.formats import load_motion
from tests.export.test_viewer import browser  # noqa: F401 - a fixture
from tests.motion.rig.foreign import nameless  # noqa: F401 - a fixture
from tests.serving.test_page import (  # noqa: F401 - fixtures
    WALK,
    WAVE,
    download,
    expect,
    generate,
    open_studio,
    serious_faults,
)
from tests.serving.test_wording import BROKEN_BVH

pytestmark = pytest.mark.slow
BOW = "a person bows politely"


def make_chain(page) -> None:
    generate(page, WALK)
    generate(page, WALK, WAVE, takes=2)
    expect(page.locator(".block")).to_have_text([WALK, WAVE])


def replace_second(page) -> None:
    page.locator(".block").nth(1).click()
    page.get_by_role("button", name="Replace sentence 2").click()
    expect(page.get_by_role("textbox", name="Sentence")).to_have_value(WAVE)
    page.keyboard.type(BOW)
    page.keyboard.press("Enter")
    expect(page.locator(".take")).to_have_count(3, timeout=60_000)
    expect(page.locator(".block")).to_have_text([WALK, BOW])


@pytest.mark.release
def test_a_stranger_replaces_a_sentence_and_takes_it_back(open_studio, tmp_path):  # noqa: F811
    page = open_studio()
    blocks = page.locator(".block")
    make_chain(page)
    before = load_motion(download(page, "NPZ", tmp_path))
    replace_second(page)
    assert serious_faults(page) == []
    after = load_motion(download(page, "NPZ", tmp_path))
    first = before.part_starts[1]
    assert after.part_starts == before.part_starts and after.num_frames == before.num_frames
    np.testing.assert_allclose(after.positions[: first - 10], before.positions[: first - 10], atol=1e-5)
    page.get_by_role("button", name="Undo").click()
    expect(blocks).to_have_text([WALK, WAVE])
    page.keyboard.press("Control+z")
    expect(page.locator("#take-title")).to_have_text(WALK)
    expect(page.locator(".take")).to_have_count(1)
    page.keyboard.press("Control+Shift+z")
    page.keyboard.press("Control+Shift+z")
    expect(blocks).to_have_text([WALK, BOW])


@pytest.mark.release
def test_a_stranger_comes_back_and_shares(open_studio, tmp_path):  # noqa: F811
    page = open_studio()
    make_chain(page)
    replace_second(page)
    page.get_by_role("radio", name="New").check(force=True)
    page.get_by_role("textbox", name="Sentence 1").fill("not sent yet")
    page.reload()
    expect(page.locator(".block")).to_have_text([WALK, BOW])
    page.get_by_role("radio", name="New").check(force=True)
    expect(page.get_by_role("textbox", name="Sentence 1")).to_have_value("not sent yet")
    ours = load_motion(download(page, "NPZ", tmp_path))
    page.get_by_role("button", name="Share").click()
    link = page.get_by_role("textbox", name="Link").input_value()
    assert serious_faults(page) == []

    other = open_studio(path=link.removeprefix(page.url))
    expect(other.locator(".block")).to_have_text([WALK, BOW], timeout=60_000)
    theirs = load_motion(download(other, "NPZ", tmp_path))
    np.testing.assert_array_equal(theirs.positions, ours.positions)
    other.locator("#file-input").set_input_files(download(other, "GLB", tmp_path))
    expect(other.locator(".take-meta").first).to_contain_text("file")
    assert serious_faults(other) == []


@pytest.mark.release
def test_variations_and_what_follows_keep_all_sentences(open_studio):  # noqa: F811
    page = open_studio()
    blocks = page.locator(".block")
    generate(page, WALK, WAVE)
    page.get_by_role("radio", name="Vary").check(force=True)
    expect(page.get_by_role("textbox", name="Sentence 2")).to_have_value(WAVE)
    expect(page.get_by_role("button", name="Remove Sentence 2")).to_be_hidden()
    page.get_by_role("button", name="Generate", exact=True).click()
    expect(page.locator(".take")).to_have_count(2, timeout=60_000)
    expect(blocks).to_have_text([WALK, WAVE])
    page.locator("#then").click()
    generate(page, BOW, takes=3)
    expect(blocks).to_have_text([WALK, WAVE, BOW])
    expect(page.locator("#take-title")).to_have_text(f"{WALK}, then {WAVE}, then {BOW}")
    assert blocks.first.get_attribute("title").startswith(f"{WALK} (0.0 s")


def test_a_page_speaks_of_the_file_that_was_dropped(open_studio, nameless, tmp_path):  # noqa: F811
    page = open_studio(may_fail=["400"])
    (tmp_path / "my walk.bvh").write_text(BROKEN_BVH)
    page.locator("#file-input").set_input_files(tmp_path / "my walk.bvh")
    expect(page.get_by_role("alert")).to_contain_text("my walk.bvh:4: OFFSET", timeout=60_000)  # a process starts
    page.locator("#file-input").set_input_files(nameless)
    expect(page.get_by_role("alert")).to_contain_text(f"{nameless.name}: no known rig")
    expect(page.get_by_role("alert")).to_contain_text("open it together with a table")
    expect(page.get_by_role("alert")).not_to_contain_text("t2m")
