"""The page that shows what was imported."""

import re
import shutil

import numpy as np
import pytest

from t2m_jax.cli.main import main
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from t2m_jax.errors import UserError
from t2m_jax.export import contact_sheet
from t2m_jax.export.contact_sheet import NUM_POSES, save_contact_sheet
from t2m_jax.motion.bvh import save_bvh
from t2m_jax.motion.motion import Motion
from tests.motion.figures import walking_positions


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sheet") / "data"
    write_synthetic_dataset(folder, num_clips=20, seed=0)
    return open_dataset(folder)


def test_each_clip_has_its_poses_captions_and_split(dataset, tmp_path):
    save_contact_sheet(tmp_path / "sheet.html", dataset, notes=["1 < 2"], left_out={"x": "<b>"})
    page = (tmp_path / "sheet.html").read_text()
    assert page.count("<article>") == 20 and "{{" not in page
    assert page.count("<polyline") == 20 * NUM_POSES * 7 and page.count("<circle") == 20 * NUM_POSES
    assert "1 &lt; 2" in page and "x: left out: &lt;b&gt;" in page
    name = next(name for name in dataset.names("val") if not name.startswith("M"))
    card = page[page.index(f"<h2>{name}</h2>") :]
    assert card.index("val, ") < card.index(dataset.captions(name)[0].text) < card.index("</article>")


def test_left_is_on_the_right_of_somebody_who_looks_at_you(tmp_path):
    source = tmp_path / "source"
    source.mkdir()
    save_bvh(source / "walk.bvh", Motion(positions=walking_positions(40), fps=20.0))
    main(["data", "import", "bvh", str(source), str(tmp_path / "data"), "--caption-from-name"])
    page = (tmp_path / "data" / "contact-sheet.html").read_text()
    first = {side: re.search(rf'class="{side}" points="([-\d]+),', page) for side in ("left", "right")}
    assert int(first["left"][1]) > int(first["right"][1])


def test_a_large_data_set_is_shown_in_part(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(contact_sheet, "MAX_CLIPS", 5)
    main(["data", "sheet", str(dataset.folder), "-o", str(tmp_path / "part.html")])
    page = (tmp_path / "part.html").read_text()
    assert page.count("<article>") == 5 and "5 of them are shown" in page and ": 20 clips" in page


def test_a_clip_without_frames_is_named(dataset, tmp_path):
    copy = shutil.copytree(dataset.folder, tmp_path / "data")
    name = dataset.names("train")[0]
    np.save(copy / "new_joint_vecs" / f"{name}.npy", np.zeros((0, 263), np.float32))
    with pytest.raises(UserError, match=f"clip {name} has no frames"):
        save_contact_sheet(tmp_path / "sheet.html", open_dataset(copy))
