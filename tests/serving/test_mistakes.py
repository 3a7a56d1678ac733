"""What the page of the studio does for somebody who changes their mind: undo, names, copies, tabs and links."""

import numpy as np
import pytest

from t2m_jax.motion.formats import load_motion
from tests.export.conftest import walk  # noqa: F401 - a fixture
from tests.export.test_viewer import browser, wait_until  # noqa: F401 - a fixture
from tests.serving.test_page import (  # noqa: F401 - fixtures
    PHONE,
    WALK,
    WAVE,
    download,
    expect,
    generate,
    open_studio,
    serious_faults,
)

pytestmark = pytest.mark.slow


@pytest.mark.release
def test_motions_are_named_copied_and_come_back(open_studio):  # noqa: F811
    page = open_studio()
    generate(page, WALK)
    captions = page.locator(".take-caption")
    page.get_by_role("button", name="Rename").click()
    assert serious_faults(page) == []
    page.get_by_role("textbox", name="Name").fill("my walk")
    page.keyboard.press("Enter")
    expect(page.locator("#take-title")).to_have_text("my walk")
    page.keyboard.press("d")
    expect(captions).to_have_text(["my walk (copy)", "my walk"])
    page.keyboard.press("Delete")
    expect(captions).to_have_text(["my walk"])
    assert serious_faults(page) == []
    page.locator("#notice").get_by_role("button", name="Undo").click()
    expect(captions).to_have_text(["my walk (copy)", "my walk"])
    page.get_by_role("button", name="Delete all").click()
    page.get_by_role("button", name="Delete", exact=True).click()
    expect(captions).to_have_count(0)
    for expected in (["my walk (copy)", "my walk"], ["my walk"], [WALK], []):
        page.keyboard.press("Control+z")
        expect(captions).to_have_text(expected)
    page.keyboard.press("Control+y")
    page.keyboard.press("Control+Shift+z")
    expect(captions).to_have_text(["my walk"])
    page.reload()
    expect(captions).to_have_text(["my walk"])
    expect(page.locator("#take-title")).to_have_text("my walk")


def test_what_is_written_can_be_undone(open_studio):  # noqa: F811
    page = open_studio()
    areas = page.locator("#sentences textarea")
    areas.first.fill(WALK)
    page.wait_for_timeout(1_100)  # a pause ends what is undone together
    page.locator("#add-sentence").click()
    page.keyboard.type(WAVE)
    page.get_by_role("button", name="Remove Sentence 1").click()
    expect(areas).to_have_count(1)
    for expected in ([WALK, WAVE], [WALK, ""], [WALK], [""]):
        page.keyboard.press("Control+z")
        expect(areas).to_have_count(len(expected))
        assert [area.input_value() for area in areas.all()] == expected
    for _ in range(3):
        page.keyboard.press("Control+Shift+z")
    expect(areas).to_have_count(2)
    assert [area.input_value() for area in areas.all()] == [WALK, WAVE]
    page.get_by_role("textbox", name="Seed").fill("12")
    page.keyboard.press("Control+z")  # a field's own
    expect(areas).to_have_count(2)


def test_two_tabs_have_one_history(open_studio):  # noqa: F811
    page = open_studio()
    other = open_studio(beside=page)
    generate(page, WALK)
    expect(other.locator(".take-caption")).to_have_text([WALK])
    other.locator(".take-open").click()
    expect(other.locator("#take-title")).to_have_text(WALK)
    other.keyboard.press("n")
    other.get_by_role("textbox", name="Name").fill("ours")
    other.keyboard.press("Enter")
    expect(page.locator(".take-caption")).to_have_text(["ours"])
    other.get_by_role("button", name="Delete ours").click()
    expect(page.locator(".take")).to_have_count(0)
    page.keyboard.press("n")
    expect(page.get_by_role("alert")).to_contain_text("this motion is no longer in the history")


def test_a_link_carries_seed_options_and_sample(open_studio, walk, tmp_path):  # noqa: F811
    page = open_studio()
    page.get_by_text("More options").click()
    page.get_by_role("spinbutton", name="Top k").fill("20")
    generate(page, WALK, samples=2)
    page.locator(".stage-caption").nth(1).click()
    ours = load_motion(download(page, "NPZ", tmp_path))
    page.get_by_role("button", name="Share").click()
    link = page.get_by_role("textbox", name="Link").input_value()
    other = open_studio(path=link.removeprefix(page.url))
    expect(other.locator("#take-facts")).to_contain_text("2 of 2", timeout=60_000)
    expect(other.get_by_role("textbox", name="Seed")).to_have_value("7")
    expect(other.locator("[data-field=top_k]")).to_have_value("20")
    assert other.url == page.url  # a reload does not make it again
    np.testing.assert_array_equal(load_motion(download(other, "NPZ", tmp_path)).positions, ours.positions)
    walk.save(tmp_path / "mine.npz")
    other.locator("#file-input").set_input_files(tmp_path / "mine.npz")
    expect(other.locator(".take")).to_have_count(2)
    other.get_by_role("button", name="Share").click()
    expect(other.locator("#notice")).to_contain_text("made from sentences alone")
    cut = link.partition("#make=")[2][:-9]
    for wrong in ("%", "3", "null", cut, '{"steps": []}', '{"steps": [null]}', '{"steps": [{"pick": 1}]}'):
        other.locator("#message").evaluate("(box) => box.replaceChildren()")
        other.evaluate("(text) => { location.hash = `make=${text}`; }", wrong)
        said = "The link cannot be opened: it is incomplete or damaged."
        expect(other.get_by_role("alert")).to_have_text(said)
        expect(other).to_have_url(page.url)


def test_a_link_to_a_motion_of_the_history_shows_it(open_studio):  # noqa: F811
    page = open_studio()
    generate(page, WALK, samples=2)
    page.locator(".stage-caption").nth(1).click()
    page.get_by_role("button", name="Share").click()
    link = page.get_by_role("textbox", name="Link").input_value()
    other = open_studio(path=link.removeprefix(page.url))
    expect(other.locator("#take-facts")).to_contain_text("2 of 2", timeout=60_000)
    other.get_by_role("button", name="Share").click()  # what came with a link has one, too
    expect(other.get_by_role("textbox", name="Link")).to_have_value(link)
    other.keyboard.press("Escape")
    generate(other, WAVE, takes=2)
    other.evaluate("(hash) => { location.hash = hash; }", link.partition("#")[2])
    expect(other.locator("#take-title")).to_have_text(WALK)
    expect(other.locator("#take-facts")).to_contain_text("2 of 2")
    expect(other).to_have_url(page.url)
    assert other.locator(".take").count() == 2


@pytest.mark.parametrize("dialog", ["help", "rename-dialog"])
def test_a_key_right_after_a_dialog_works(open_studio, dialog):  # noqa: F811
    page = open_studio()
    page.evaluate(
        """(name) => {
            const dialog = document.getElementById(name);
            dialog.showModal();
            dialog.close();
            document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key: "?", bubbles: true }));
        }""",
        dialog,
    )
    expect(page.get_by_role("dialog", name="Keys")).to_be_visible()


@pytest.mark.parametrize("viewport", [pytest.param({"width": 1440, "height": 900}, marks=pytest.mark.release), PHONE])
def test_the_stage_fills_the_screen(open_studio, viewport):  # noqa: F811
    page = open_studio(viewport=viewport)
    generate(page, WALK)
    page.locator("h1").click()
    before = page.locator("#stage").bounding_box()
    page.keyboard.press("m")
    expect(page.locator("#make")).to_be_hidden()
    full = page.locator("#stage").bounding_box()
    assert full["width"] >= before["width"] and full["height"] > before["height"]
    expect(page.get_by_role("button", name="Play")).to_be_in_viewport(ratio=1)
    page.keyboard.press("m")
    expect(page.locator("#make")).to_be_visible()
    expect(page.get_by_role("button", name="Full screen")).to_have_attribute("aria-pressed", "false")


def test_quick_keys_fill_the_screen_or_not(open_studio):  # noqa: F811
    page = open_studio()
    page.evaluate("window.changes = 0; document.addEventListener('fullscreenchange', () => { window.changes += 1; })")
    key = "new KeyboardEvent('keydown', { key: 'm', bubbles: true })"
    press = f"(times) => {{ while (times--) document.body.dispatchEvent({key}); }}"
    page.evaluate(press, 2)
    wait_until(page, "window.changes === 2 && !document.fullscreenElement")
    page.evaluate(press, 1)
    wait_until(page, "window.changes === 3 && document.fullscreenElement")
    page.evaluate(press, 2)
    wait_until(page, "window.changes === 5 && document.fullscreenElement")
    expect(page.locator("#make")).to_be_hidden()
    page.evaluate(press, 1)
    wait_until(page, "window.changes === 6 && !document.fullscreenElement")
    expect(page.locator("#make")).to_be_visible()
