"""The page of a report: self-contained, the same each time, and nothing a caption says does anything."""

import html
import os
import re
import shutil

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.evaluation.report.gallery import Example, RepeatDetails
from t2m_jax.evaluation.report.page import codes_plot, lengths_plot, report_page, save_page
from t2m_jax.evaluation.report.record import Header, Metric, Report
from t2m_jax.export import viewer_html
from t2m_jax.metrics.quality import MotionQuality
from t2m_jax.motion.motion import Motion

NASTY = 'walks </script><img src=x onerror="alert(1)"> {{table}} & "waves" \\1 <!-- é'


def metrics(shift, *names):
    repeats = {name: tuple(number + shift + wave / 8 for wave in (0, 1, 3)) for number, name in enumerate(names)}
    return {name: Metric(float(np.mean(values)), 0.25, values) for name, values in repeats.items()}


HEADER = Header(
    protocol="strict",
    model="runs/<b>mine</b>",
    data="walks & turns",
    split="test",
    num_samples=64,
    evaluator="abc",
    weights="ab",
    contents="cd",
    sampling="greedy",
    seed=0,
    unit=4,
    batch=32,
)
REPORT = Report(
    header=HEADER,
    kind="generated",
    real=metrics(0.5, "r_precision_1", "diversity", *MotionQuality._fields),
    measured=metrics(0.25, "r_precision_1", "fid", "diversity", *MotionQuality._fields),
)


@pytest.fixture(scope="module")
def motion():
    return Motion(make_motion("walk", seed=0, num_frames=24), 20.0, caption="a person walks")


@pytest.fixture
def details(motion):
    both = (motion.positions, motion.positions)
    return RepeatDetails(
        kind="generated",
        skeleton=motion.skeleton,
        real_lengths=np.array([40, 44, 80, 196]),
        measured_lengths=np.array([40, 40, 60, 100]),
        real_code_counts=np.array([4, 0, 3, 1]),
        measured_code_counts=np.array([0, 0, 8, 8]),
        ranks=np.array([1, 2, 1, 7]),
        examples=(Example("a person walks", 2, 2.5, 1.25, *both),),
        failures=(Example(NASTY, 7, 4.0, 1.5, *both),),
    )


def captions_alone(motions):
    return f"<iframe>{html.escape('|'.join(motion.caption for motion in motions))}</iframe>"


@pytest.fixture
def page(details):
    return report_page(REPORT, details, viewer=captions_alone)


def test_the_same_report_makes_the_same_page(details, page):
    assert report_page(REPORT, details, viewer=captions_alone) == page


def test_it_fetches_nothing(page):
    assert "http:" not in page and "https:" not in page and "@import" not in page
    assert set(re.findall(r'(?:src|href)="([^"]*)"', page)) <= {"data:,"} | set(re.findall(r'href="(#[^"]*)"', page))
    assert "default-src 'none'" in page


def test_it_says_what_was_measured(page):
    text = html.unescape(re.sub(r"<[^>]+>", " ", page))
    for words in ("walks & turns", "greedy", "Mean and 95 % interval over 3 repeats.", "Diversity →"):
        assert words in text, words
    assert "None" not in text and "left out" not in text
    assert "R top-2" not in text, "a metric that nobody measured"
    assert "uses 75.0 % of the codes, perplexity 2.6" in text
    assert "generated uses 50.0 % of the codes, perplexity 2.0" in text
    assert "Mean length: real motion 4.50 s, generated 3.00 s" in text
    assert "Of 4 captions, 50.0 % find their own motion nearest; the median rank is 1.5" in text
    assert "rank 2, distance 2.50; the real motion's distance is 1.25" in text
    assert "rank 7, distance 4.00; the real motion's distance is 1.50" in text


def test_viewers_show_whose_motion_is_whose(page):
    shown = [html.unescape(text) for text in re.findall(r"<iframe>(.*?)</iframe>", page)]
    assert shown == [f"1, generated: {caption}|1, real: {caption}" for caption in ("a person walks", NASTY)]


def test_texts_of_the_user_stay_text(page):
    assert "<img" not in page and "<b>mine" not in page
    assert page.count(html.escape(NASTY)) == 3, "the failure, and the captions of its motions"
    assert page.count("</script>") == 0
    assert page.count("<table>") == 2, "a caption was taken for a place in the page"


def places(svg):
    """Returns the corners of the line of each kind."""
    lines = re.findall(r'<polyline points="([^"]*)" fill="none" stroke="var\(--(\w+)\)"', svg)
    return {kind: np.array([pair.split(",") for pair in points.split()], float) for points, kind in lines}


def test_plots_show_each_kind_in_the_color_of_the_page():
    lengths = lengths_plot({"real": np.array([40, 40, 196]), "generated": np.array([40, 4])}, fps=20.0)
    codes = codes_plot({"real": np.array([1, 5, 0]), "generated": np.array([0, 1, 1])})
    for svg in (lengths, codes):
        assert svg.startswith("<svg") and svg.endswith("</svg>") and "var(--faint)" in svg
        assert set(places(svg)) == {"real", "generated"}
    assert "66.7 %" in lengths and "9.8 s" in lengths
    # The highest share is at 20 of 160, none is at 140; the codes that real motion uses most come first.
    assert places(codes)["real"][::2, 1].round().tolist() == [20, 116, 140]
    assert places(codes)["generated"][::2, 1].round().tolist() == [68, 140, 68]


def test_plots_of_one_value_and_of_unused_codebooks():
    assert "<svg" in codes_plot({"real": np.zeros(3, int), "reconstruction": np.zeros(3, int)})
    assert "<svg" in lengths_plot({"real": np.array([4]), "reconstruction": np.array([4])}, fps=20.0)


@pytest.fixture
def open_in_browser(tmp_path):
    """Returns a function that opens a file, and afterwards nothing may have gone wrong."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    from tests.export.test_viewer import ARGUMENTS

    path = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("no Chromium found (CHROMIUM names one)")
    troubles = []
    with playwright.sync_playwright() as running:
        chromium = running.chromium.launch(executable_path=path, headless=True, args=ARGUMENTS)

        def open_page(file):
            opened = chromium.new_page(viewport={"width": 420, "height": 600}, reduced_motion="reduce")
            opened.on("console", lambda message: troubles.append(message.text) if message.type == "error" else None)
            opened.on("pageerror", lambda error: troubles.append(str(error)))
            opened.on("dialog", lambda dialog: troubles.append(dialog.message))
            opened.on("request", lambda request: troubles.append(request.url) if request.url != file.as_uri() else None)
            opened.goto(file.as_uri())
            return opened

        yield open_page
        chromium.close()
    assert not troubles


@pytest.mark.slow
def test_viewers_play_in_the_page(open_in_browser, details, tmp_path):
    path = tmp_path / "page.html"
    save_page(path, REPORT, details, viewer=viewer_html)
    page = open_in_browser(path)
    frames = page.locator("iframe")
    assert frames.count() == 2
    assert page.evaluate("document.documentElement.scrollWidth") <= 420, "the page is wider than the screen"
    frames.first.scroll_into_view_if_needed()
    inside = page.frame_locator("iframe").first
    inside.locator("canvas").wait_for()
    assert inside.locator(".stage-caption").all_text_contents() == [
        f"1, {kind}: a person walks" for kind in ("generated", "real")
    ]
