"""The page of the studio when users are hasty, and what it says to screen readers in all of its states."""

import pytest

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
