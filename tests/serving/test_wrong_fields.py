"""What the page of the studio does with values that nobody can use, and with choices that a file cannot have."""

import pytest

from tests.export.conftest import walk  # noqa: F401 - a fixture
from tests.export.test_viewer import browser  # noqa: F401 - a fixture
from tests.serving.test_page import (  # noqa: F401 - fixtures
    WALK,
    download,
    expect,
    open_studio,
    open_two_sentences,
)

pytestmark = pytest.mark.slow


@pytest.fixture
def page(open_studio, walk, tmp_path):  # noqa: F811
    """The page with a motion of two sentences, of 2.0 s each or nearly; `page.asked` are its requests for motions."""
    page = open_studio()
    open_two_sentences(page, walk, tmp_path)
    page.asked = []
    page.on("request", lambda request: page.asked.append(request.url) if "/motions?" in request.url else None)
    return page


def type_into(page, field, text, key) -> None:
    field.click()
    page.keyboard.press("Control+A")
    page.keyboard.type(text) if text else page.keyboard.press("Delete")
    page.keyboard.press(key)


@pytest.mark.parametrize("key", ["Tab", "Enter"])
def test_a_length_that_is_none_changes_nothing(page, key):
    page.locator(".block").first.click()
    field = page.get_by_role("spinbutton", name="Sentence length")
    before = field.input_value()
    for text in ("", "e", "-"):
        type_into(page, field, text, key)
        expect(field).to_have_value(before)
        expect(page.get_by_role("alert")).to_be_empty()
    for text, complaint in (("-3", "0.4"), ("0", "0.4"), ("1e9", "60"), ("60.4", "60")):
        type_into(page, field, text, key)
        expect(page.get_by_role("alert")).to_contain_text("Sentence length: Value must be ")
        expect(page.get_by_role("alert")).to_contain_text(f" {complaint}.")
        expect(field).to_have_value(before)
    assert page.locator("[data-length]").count() == 0 and page.asked == []


def test_a_length_is_shown_as_it_is_made(page):
    """Lengths are whole rows of codes of 0.4 s."""
    page.locator(".block").first.click()
    field = page.get_by_role("spinbutton", name="Sentence length")
    before = field.input_value()
    type_into(page, field, str(float(before) + 0.1), "Enter")
    expect(field).to_have_value(before)
    assert page.asked == []


@pytest.mark.parametrize(("name", "text"), [("Begin", ""), ("End", ""), ("Begin", "e"), ("End", "-")])
def test_an_empty_end_of_the_span_changes_nothing(page, name, text):
    page.locator(".block").nth(1 if name == "Begin" else 0).click()
    field = page.locator(f"#{name.lower()}")
    before = field.input_value()
    type_into(page, field, text, "Tab")
    expect(field).to_have_value(before)
    expect(page.get_by_role("slider", name=f"{name} of the span")).to_have_attribute("aria-valuenow", before)


@pytest.mark.parametrize("by", ["field", "handle"])
def test_a_wrong_option_stops_another_length_too(page, by):
    page.locator(".block").first.click()
    field = page.get_by_role("spinbutton", name="Sentence length")
    before = field.input_value()
    page.get_by_text("More options").click()
    option = page.get_by_role("spinbutton", name="Temperature")
    option.click()
    page.keyboard.type("1e")
    if by == "field":
        type_into(page, field, "3.2", "Tab")
    else:
        page.get_by_role("slider", name="Length of sentence 1").focus()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Enter")
    expect(page.get_by_role("alert")).to_contain_text("Temperature: ")
    expect(option).to_be_focused()
    expect(field).to_have_value(before)
    assert page.locator("[data-length]").count() == 0 and page.asked == []


def test_limits_that_are_excluded_themselves_are_checked(page):
    page.get_by_text("More options").click()
    page.get_by_role("radio", name="New").check(force=True)
    page.get_by_role("textbox", name="Sentence").first.fill(WALK)
    for text in ("0", "-0", "0.0", "-2"):
        page.get_by_role("spinbutton", name="Seconds").fill(text)
        page.get_by_role("button", name="Generate", exact=True).click()
        expect(page.get_by_role("alert")).to_contain_text("Seconds: Value must be greater than ")
    assert page.asked == []


def test_only_what_a_format_has_is_asked_for(page, tmp_path):
    """A choice that another format does not have comes back with a format that has it."""
    sent = []
    page.on("request", lambda request: sent.append(request.url.partition("?")[2]) if "/files?" in request.url else None)
    choose = lambda name: page.get_by_role("radio", name=name, exact=True).check(force=True)  # noqa: E731
    names = page.get_by_role("combobox", name="Joint names")
    choose("BVH")
    names.select_option("unreal")
    page.get_by_role("combobox", name="Units").select_option("cm")
    page.get_by_role("checkbox", name="Root bone").check()
    for name in ("NPZ", "VRMA", "GLB"):
        download(page, name, tmp_path)
    assert sent == ["format=npz", "format=vrma", "names=unreal&units=cm&root_bone=true&format=glb"]
    choose("NPZ")
    expect(names).to_have_value("")
    enabled = "(select) => [...select.options].filter((option) => !option.disabled).map((option) => option.value)"
    assert names.evaluate(enabled) == ["", "humanml3d", "smpl"]
    names.select_option("smpl")
    choose("HTML")
    for field in (names, page.get_by_role("combobox", name="Units"), page.get_by_role("combobox", name="Camera")):
        expect(field).to_be_hidden()
    choose("NPZ")
    expect(names).to_have_value("smpl")
    download(page, "NPZ", tmp_path)
    assert sent[-1] == "names=smpl&format=npz"
