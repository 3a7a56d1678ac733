import base64
import html.parser
import importlib.resources
import json
import re
import zlib

import numpy as np
import pytest

from t2m_jax.export.html import STUDIO_SCRIPTS, save_html, viewer_html, viewer_script
from t2m_jax.export.render.scene import figure_from_motion
from t2m_jax.motion.motion import Motion
from tests.export.conftest import NASTY_CAPTION

EMPTY = base64.b64encode(zlib.compress(b"")).decode()


class Elements(html.parser.HTMLParser):
    """Collects the start tags of a page and what its data element and its program hold."""

    def __init__(self, page: str):
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.texts: dict[str, str] = {}
        self.feed(page)
        self.close()
        self.data, self.program = (
            zlib.decompress(base64.b64decode(self.texts.get(name, EMPTY))).decode()
            for name in ("motion-data", "program")
        )

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        if self.tags and self.tags[-1][0] == "script":
            self.texts.setdefault(self.tags[-1][1].get("id"), data)


def test_the_page_is_small_and_whole(tmp_path, walk):
    motion = Motion(np.concatenate([walk.positions] * 3)[:200], 20.0, caption="walks")
    save_html(tmp_path / "a.html", [motion])
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert len(page.encode()) < 1_200_000
    assert "{{" not in page
    page += Elements(page).program
    page = page.replace("http://www.w3.org/1999/xhtml", "")  # a name that three.js gives to elements, not an address
    assert not re.search(r"""(src|href)\s*=\s*["'](?!data:)|@import|url\(|https?://""", page)
    assert "default-src 'none'" in page


def test_a_page_has_the_license_of_three_js(walk):
    page = viewer_html([walk], embed=False)
    folder = importlib.resources.files("t2m_jax.export") / "viewer" / "vendor"
    text = (folder / "LICENSE").read_text(encoding="utf-8").strip()
    assert "Permission is hereby granted" in text
    assert text in page and text in Elements(page).program
    assert text in viewer_script(*STUDIO_SCRIPTS)


def test_a_page_with_many_motions_is_small(walk):
    rng = np.random.default_rng(0)
    motions = [
        Motion(np.tile(walk.positions, (3, 1, 1))[:196] * np.float32(scale), 20.0, caption="walks")
        for scale in rng.uniform(0.8, 1.2, 24)
    ]
    assert len(viewer_html(motions, embed=False)) < 1_200_000


def test_positions_come_back_from_the_page(walk, kit_walk):
    document = json.loads(Elements(viewer_html([walk, kit_walk], embed=False)).data)
    figures = [figure_from_motion(motion) for motion in (walk, kit_walk)]
    for record, figure in zip(document["figures"], figures, strict=True):
        differences = np.frombuffer(base64.b64decode(record["data"]), "<i2").reshape(-1, record["frames"])
        steps = np.cumsum(np.cumsum(differences, axis=1, dtype="<i2"), axis=1, dtype="<i2").T
        steps = steps.reshape(record["frames"], record["points"], 3)
        np.testing.assert_allclose(steps * record["step"] + record["origin"], figure.points, atol=2.1e-4)
        assert record["fps"] == figure.fps and len(record["parts"]) == len(figure.parts)
    assert document["seconds"] == pytest.approx(kit_walk.seconds)


def test_far_travel_costs_precision_not_size(walk):
    far = Motion(
        walk.positions * np.float32([1, 1, 1]) + np.linspace(0, 500, 80, dtype=np.float32)[:, None, None], 20.0
    )
    record = json.loads(Elements(viewer_html([far], embed=False)).data)["figures"][0]
    assert record["step"] < 0.02


@pytest.mark.parametrize("caption", [NASTY_CAPTION, "", "\x00\x1f\ud800 half a surrogate", "x" * 10_000])
def test_captions_stay_text(walk, caption):
    motion = Motion(walk.positions, 20.0, caption=caption)
    plain = Elements(viewer_html([Motion(walk.positions, 20.0)], embed=False))
    nasty = Elements(viewer_html([motion], embed=False))
    assert nasty.tags == plain.tags
    # A motion has a mark in place of half a character.
    assert json.loads(nasty.data)["figures"][0]["caption"] == caption.replace("\ud800", "\ufffd")


def test_a_strange_caption_is_written_to_disk(tmp_path, walk):
    save_html(tmp_path / "a.html", [Motion(walk.positions, 20.0, caption="\ud800 half a surrogate")])
    assert (tmp_path / "a.html").stat().st_size > 10_000


def test_notebooks_get_one_frame_that_holds_the_page(nasty):
    embedded = Elements(viewer_html([nasty]))
    (tag, attributes), *others = embedded.tags
    assert tag == "iframe" and not others and attributes["sandbox"] == "allow-scripts"
    assert attributes["srcdoc"] == viewer_html([nasty], embed=False)
    assert nasty._repr_html_() == viewer_html([nasty])
