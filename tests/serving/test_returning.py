"""What the page of the studio still has when somebody comes back to it."""

import pytest

from docs.measure.studio import FILL
from tests.export.conftest import walk  # noqa: F401 - a fixture
from tests.export.test_viewer import browser, wait_until  # noqa: F401 - a fixture
from tests.serving.test_hasty_users import SLOW_STREAM
from tests.serving.test_page import (  # noqa: F401 - fixtures
    WALK,
    WAVE,
    expect,
    generate,
    open_studio,
    open_two_sentences,
)

pytestmark = pytest.mark.slow

LONG_AGO = """new Promise((done) => {
  const request = indexedDB.open("t2m-studio");
  request.onsuccess = () => {
    const entries = request.result.transaction("entries", "readwrite").objectStore("entries");
    entries.getAll().onsuccess = ({ target }) => {
      for (const entry of target.result) entries.put({ ...entry, deleted: 1 });
    };
    entries.transaction.oncomplete = () => { request.result.close(); done(); };
  };
})"""
"""Says of all motions of the history that they were deleted in 1970."""


def test_a_reload_keeps_the_draft_the_settings_and_the_selection(open_studio):  # noqa: F811
    page = open_studio()
    generate(page, WAVE)
    generate(page, WALK, samples=2, takes=2)
    page.locator(".stage-caption").nth(1).click()
    page.get_by_role("spinbutton", name="Begin").fill("0.2")
    page.get_by_role("combobox", name="Joint names").select_option("mixamo")
    page.get_by_role("checkbox", name="All samples").check()
    page.get_by_role("radio", name="Redo part").check(force=True)
    page.get_by_role("textbox", name="Sentence").fill("a draft")
    page.get_by_text("More options").click()
    page.get_by_role("spinbutton", name="Top k").fill("20")
    page.locator("#changes summary").click()
    page.get_by_role("checkbox", name="Mirrored").check()
    page.get_by_role("checkbox", name="Only the span").uncheck()
    page.get_by_role("radio", name="MP4").check(force=True)  # which has no names of joints
    page.get_by_role("combobox", name="Speed", exact=True).select_option("0.5")
    page.reload()
    expect(page.locator("#take-title")).to_have_text(WALK)
    expect(page.locator("#take-facts")).to_contain_text("2 of 2")
    expect(page.locator("#begin")).to_have_value("0.20")
    expect(page.get_by_role("radio", name="Redo part")).to_be_checked()
    expect(page.get_by_role("textbox", name="Sentence")).to_have_value("a draft")
    expect(page.get_by_role("textbox", name="Seed")).to_have_value("7")
    expect(page.get_by_role("combobox", name="Samples")).to_have_value("2")
    expect(page.locator("[data-field=top_k]")).to_have_value("20")
    expect(page.get_by_role("button", name="Download MP4")).to_be_visible()
    expect(page.get_by_role("checkbox", name="Mirrored")).to_be_checked()
    expect(page.get_by_role("checkbox", name="Only the span")).not_to_be_checked()
    expect(page.get_by_role("checkbox", name="All samples")).to_be_checked()
    page.get_by_role("radio", name="GLB").check(force=True)
    expect(page.get_by_role("combobox", name="Joint names")).to_have_value("mixamo")
    expect(page.get_by_role("combobox", name="Speed", exact=True)).to_have_value("0.5")
    page.get_by_role("radio", name="New").check(force=True)
    expect(page.get_by_role("textbox", name="Sentence")).to_have_value(WALK)  # what was sent is no draft


def test_a_deleted_motion_comes_back_although_another_tab_was_opened_later(open_studio, walk, tmp_path):  # noqa: F811
    page = open_studio()
    open_two_sentences(page, walk, tmp_path)
    page.keyboard.press("Delete")
    expect(page.locator(".take")).to_have_count(0)
    page.evaluate(LONG_AGO)
    open_studio(beside=page)
    page.keyboard.press("Control+z")
    expect(page.locator(".take")).to_have_count(1)
    page.reload()
    expect(page.locator(".block")).to_have_text([WALK, WAVE])


@pytest.mark.release
def test_a_reload_keeps_the_view(open_studio):  # noqa: F811
    page = open_studio()
    title, hint = page.locator("#take-title"), page.locator("#compare-hint")
    generate(page, WAVE)
    generate(page, WALK, takes=2)
    page.get_by_role("button", name=f"Compare {WALK}").click()
    page.get_by_text("More options").click()
    page.locator("#changes summary").click()
    page.get_by_role("slider", name="Frame", exact=True).fill("8")
    page.reload()
    expect(title).to_have_text(WALK)
    expect(hint).to_contain_text(WALK)
    expect(page.locator("#clock")).to_contain_text("frame 8")
    expect(page.locator("[data-field=top_k]")).to_be_visible()
    expect(page.locator("#apply-changes")).to_be_visible()
    page.get_by_role("button", name=f"Compare {WAVE}").click()
    expect(title).to_have_text("Comparison")
    captions = page.locator(".stage-caption").all_text_contents()
    page.reload()
    expect(title).to_have_text("Comparison")
    expect(page.locator(".stage-caption")).to_have_text(captions)
    expect(hint).to_be_hidden()
    page.get_by_role("button", name=f"Delete {WALK}").click()
    page.reload()
    expect(title).to_have_text(WAVE)  # what is left


def test_a_motion_that_is_made_is_found_again(open_studio):  # noqa: F811
    page = open_studio()
    page.get_by_role("textbox", name="Sentence").fill(WALK)
    page.get_by_role("spinbutton", name="Seconds").fill("60")
    page.keyboard.press("Enter")
    expect(page.locator("#status")).to_have_text("Generating …")
    page.reload()
    expect(page.locator("#take-title")).to_have_text(WALK, timeout=60_000)
    expect(page.locator(".take")).to_have_count(1)
    page.reload()
    expect(page.locator("#take-title")).to_have_text(WALK)
    expect(page.get_by_role("button", name="Generate", exact=True)).to_be_visible()
    expect(page.locator(".take")).to_have_count(1)


def test_a_motion_that_the_server_lost_is_told(open_studio):  # noqa: F811
    page = open_studio(may_fail=["404"])
    page.route("**/motions?*", lambda route: None)
    page.get_by_role("textbox", name="Sentence").fill(WALK)
    page.keyboard.press("Enter")
    page.reload()
    expect(page.get_by_role("alert")).to_contain_text("no longer has this motion")
    expect(page.get_by_role("textbox", name="Sentence")).to_have_value(WALK)
    expect(page.get_by_role("button", name="Generate", exact=True)).to_be_visible()


def test_the_share_and_the_time_left_are_shown(open_studio):  # noqa: F811
    page = open_studio()
    page.evaluate(SLOW_STREAM)
    for number, sentence in enumerate((WALK, WAVE, WALK, WAVE)):
        if number:
            page.locator("#add-sentence").click()
        page.locator("#sentences textarea").last.fill(sentence)
    page.keyboard.press("Enter")
    bar, left = page.get_by_role("progressbar", name="Generation"), page.locator("#time-left")
    wait_until(page, "window.next !== undefined")
    page.evaluate("window.next('event: started')")
    assert bar.get_attribute("aria-valuenow") is None
    assert bar.evaluate("(bar) => getComputedStyle(bar, '::after').opacity") == "0.4"  # full, but not as if done
    expect(left).to_contain_text(" s so far")
    page.evaluate("window.next('event: progress')")  # after the first of four sentences
    share = int(bar.get_attribute("aria-valuenow"))
    assert 10 < share < 25
    expect(left).to_contain_text(f"{share} % done, about")
    page.evaluate("window.next('event: done')")
    expect(left).to_be_empty()
    expect(bar).to_be_hidden()


WATCH_HISTORY = """() => {
  window.changed = 0;
  const count = (records) => {
    for (const { addedNodes, removedNodes } of records) window.changed += addedNodes.length + removedNodes.length;
  };
  new MutationObserver(count).observe(document.getElementById("takes"), { childList: true, subtree: true });
}"""


@pytest.mark.release
def test_a_history_of_200_motions_is_not_drawn_anew(open_studio):  # noqa: F811
    """The work of an action is a row or two, however long the history is."""
    page = open_studio()
    generate(page, WALK)
    page.evaluate(FILL, 200)
    page.reload()
    expect(page.locator(".take")).to_have_count(200)
    page.evaluate(WATCH_HISTORY)
    page.locator(".take-open").nth(150).click()
    page.locator("h1").click()
    page.keyboard.press("n")
    page.get_by_role("textbox", name="Name").fill("mine")
    page.keyboard.press("Enter")
    expect(page.locator(".take-caption").nth(150)).to_have_text("mine")
    page.keyboard.press("d")
    expect(page.locator(".take")).to_have_count(201)
    page.keyboard.press("Delete")
    expect(page.locator(".take")).to_have_count(200)
    page.keyboard.press("Control+z")
    expect(page.locator(".take")).to_have_count(201)
    # Five rows: the old name and the new one, the copy, which goes and comes back.
    assert page.evaluate("window.changed") == 5
