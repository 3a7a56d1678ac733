"""The page of the studio when users are hasty, and what it says to screen readers in all of its states."""

import pytest

from tests.export.conftest import walk  # noqa: F401 - a fixture
from tests.export.test_viewer import browser, wait_until  # noqa: F401 - a fixture
from tests.serving.test_page import (  # noqa: F401 - fixtures
    PHONE,
    WALK,
    WAVE,
    WIDE,
    expect,
    generate,
    num_frames,
    open_studio,
    open_two_sentences,
    serious_faults,
)

pytestmark = pytest.mark.slow


@pytest.mark.release
@pytest.mark.parametrize("viewport", [pytest.param(WIDE, marks=pytest.mark.release), PHONE])
def test_accessibility_of_dialogs_and_errors(open_studio, viewport):  # noqa: F811
    page = open_studio(viewport=viewport)
    page.get_by_role("button", name="Generate", exact=True).click()
    expect(page.get_by_role("alert")).to_have_text("Write a sentence first.")
    page.locator("#add-sentence").click()
    assert serious_faults(page) == []
    page.get_by_role("button", name="Help").click()
    assert serious_faults(page) == []
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Remove Sentence 2").click()
    generate(page, WALK, samples=2)
    page.get_by_role("button", name="Compare", exact=True).click()
    assert serious_faults(page) == []
    page.locator(".stage-caption").nth(1).click()
    page.get_by_role("button", name="Compare", exact=True).click()
    expect(page.locator("#take-title")).to_have_text("Comparison")
    assert serious_faults(page) == []
    page.get_by_role("button", name="Delete all").click()
    assert serious_faults(page) == []


def test_a_double_click_is_one_click(open_studio):  # noqa: F811
    page = open_studio()
    page.get_by_role("textbox", name="Sentence").fill(WALK)
    page.get_by_role("button", name="Generate", exact=True).dblclick()
    expect(page.locator(".take")).to_have_count(1, timeout=60_000)
    page.get_by_role("button", name="Generate", exact=True).click()
    expect(page.locator(".take")).to_have_count(2, timeout=60_000)
    page.get_by_role("button", name=f"Delete {WALK}").first.dblclick()
    page.wait_for_timeout(300)
    expect(page.locator(".take")).to_have_count(1)


def test_messages_cover_no_buttons(open_studio):  # noqa: F811
    page = open_studio()
    generate(page, WALK)
    page.get_by_role("spinbutton", name="Begin").fill("0.2")
    page.get_by_role("textbox", name="Sentence").fill("")
    page.get_by_role("button", name="Generate", exact=True).click()
    expect(page.get_by_role("alert")).to_have_text("Write a sentence first.")
    for name in ("Whole motion", "Continue with …", "Download GLB", "Generate", "Open file", "Help"):
        page.get_by_role("button", name=name).click(trial=True, timeout=2_000)


NEXT_FRAMES = """window.next('"figures"')"""

# The answer of the server comes in parts when a test calls `next`.
SLOW_STREAM = r"""() => {
  const { fetch } = window;
  window.fetch = async (path, ...more) => {
    const answer = await fetch(path, ...more);
    if (!path.startsWith("motions?")) return answer;
    const parts = (await answer.text()).split("\n\n").filter(Boolean);
    const encoder = new TextEncoder();
    const body = new ReadableStream({ start(stream) {
      window.next = (wanted) => {
        while (parts.length) {
          const part = parts.shift();
          stream.enqueue(encoder.encode(part + "\n\n"));
          if (part.includes(wanted)) return;
        }
        stream.close();
      };
    } });
    return new Response(body);
  };
}"""


def test_another_motion_can_be_shown_while_one_is_made(open_studio):  # noqa: F811
    page = open_studio()
    generate(page, WAVE)
    frames = num_frames(page)
    page.evaluate(SLOW_STREAM)
    page.get_by_role("textbox", name="Seed").fill("4")  # a long walk, which comes in several pieces
    page.get_by_role("textbox", name="Sentence").fill(WALK)
    page.keyboard.press("Enter")
    wait_until(page, "window.next !== undefined")
    page.evaluate(NEXT_FRAMES)
    expect(page.locator(".stage-caption")).to_have_text(WALK)
    page.locator(".take-open").click()
    expect(page.locator(".stage-caption")).to_have_text(WAVE)
    page.evaluate(NEXT_FRAMES)
    page.wait_for_timeout(200)
    expect(page.locator(".stage-caption")).to_have_text(WAVE)
    expect(page.locator("#clock")).to_contain_text(f"/ {frames / 20:.2f} s")
    page.evaluate("window.next('event: done')")
    expect(page.locator("#take-title")).to_have_text(WALK)


def type_number(page, name, number) -> None:
    """Types a number into a field, and does not leave it."""
    page.get_by_role("spinbutton", name=name).click()
    page.keyboard.press("Control+A")
    page.keyboard.type(number)


SHORTCUTS = "snd"  # split, rename, duplicate


def test_a_click_into_a_sentence_ends_what_is_typed_in_a_number(open_studio, walk, tmp_path):  # noqa: F811
    page, asked = open_studio(), []
    open_two_sentences(page, walk, tmp_path)
    page.get_by_role("radio", name="Redo part").check(force=True)
    sentence = page.get_by_role("textbox", name="Sentence")
    for seconds in ("1.5", "1.2"):
        type_number(page, "End", seconds)
        sentence.click()
        expect(page.locator("#end-handle")).to_have_attribute("aria-valuenow", f"{float(seconds):.2f}")
        expect(sentence).to_be_focused()
        page.keyboard.type(SHORTCUTS)
        assert sentence.input_value().count(SHORTCUTS) == (1 if seconds == "1.5" else 2)
    assert page.locator(".take").count() == 1 and page.locator("dialog[open]").count() == 0
    page.route("**/motions?*", lambda route: asked.append(route.request.post_data_json))
    type_number(page, "End", "1")
    sentence.fill("a person bows")
    page.get_by_role("button", name="Generate", exact=True).click()
    expect(page.get_by_role("button", name="Cancel")).to_be_visible()
    assert [one["captions"] for one in asked] == [["a person bows"]]
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Whole motion").click()
    type_number(page, "End", "1.4")
    page.get_by_role("button", name="Generate", exact=True).click()  # which must not move under the pointer
    expect(page.get_by_role("button", name="Cancel")).to_be_visible()
    assert [one["span"] for one in asked] == [[0, 1], [0, 1.4]]


def test_a_click_on_a_target_ends_what_is_typed_in_a_number(open_studio, walk, tmp_path):  # noqa: F811
    page = open_studio()
    open_two_sentences(page, walk, tmp_path)
    page.locator("#targets summary").click()
    field, rows = page.get_by_role("textbox", name="As a text"), page.locator(".target")
    field.fill("1 head=0,1,0; 1.5 left_wrist=0,1,0; 2 root=0,1")
    rows.first.locator(".target-open").click()
    type_number(page, "x, m", "0.25")
    rows.nth(1).locator(".target-open").click()
    expect(field).to_have_value("1 head=0.25,1,0; 1.5 left_wrist=0,1,0; 2 root=0,1")
    expect(rows.nth(1).locator("[aria-current]")).to_be_visible()
    type_number(page, "Time, s", "-3")
    page.keyboard.press("Tab")
    expect(page.get_by_role("spinbutton", name="Time, s")).to_have_value("0")
    type_number(page, "y, m", "1.25")
    page.get_by_role("button", name="Delete the target 3").click()
    expect(field).to_have_value("1 head=0.25,1,0; 0 left_wrist=0,1.25,0")
    expect(rows).to_have_count(2)


@pytest.mark.parametrize("name", ["Sentence", "x, m"])
def test_a_motion_that_is_ready_does_not_disturb_who_types(open_studio, walk, tmp_path, name):  # noqa: F811
    page = open_studio()
    open_two_sentences(page, walk, tmp_path)
    page.evaluate(SLOW_STREAM)
    page.get_by_role("button", name="Remove Sentence 2").click()
    page.get_by_role("textbox", name="Seed").fill("4")  # a long walk, which comes in several pieces
    page.get_by_role("textbox", name="Sentence").fill(WALK)
    page.keyboard.press("Enter")
    wait_until(page, "window.next !== undefined")
    if name == "Sentence":
        page.keyboard.press("Control+A")
        page.keyboard.type("a person")
    else:
        page.locator("#targets summary").click()
        page.get_by_role("textbox", name="As a text").fill("1 head=0,1,0")
        page.locator(".target-open").click()
        type_number(page, name, "0.2")
    page.evaluate("window.block = document.querySelector('.block')")
    page.evaluate(NEXT_FRAMES)
    expect(page.locator(".stage-caption")).to_have_text(WALK)
    is_kept = page.evaluate("block.isConnected")
    page.evaluate("window.next('event: done')")
    expect(page.locator("#take-title")).to_have_text(WALK)
    page.keyboard.type("5" if name == "x, m" else f" {SHORTCUTS}")
    field = page.get_by_role("spinbutton" if name == "x, m" else "textbox", name=name, exact=True)
    expect(field).to_have_value("0.25" if name == "x, m" else f"a person {SHORTCUTS}")
    assert is_kept
    assert page.locator(".take").count() == 2 and page.locator("dialog[open]").count() == 0
