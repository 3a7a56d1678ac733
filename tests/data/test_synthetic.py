import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.synthetic import KINDS, make_motion, write_synthetic_dataset
from t2m_jax.errors import UserError
from t2m_jax.motion.facts import measure
from t2m_jax.motion.skeleton import HUMANML3D
from tests.data.synthetic_scale import write_scaled_dataset


@pytest.mark.parametrize("kind", KINDS)
def test_motions_are_made_of_the_template_and_stand_on_the_floor(kind):
    positions = make_motion(kind, seed=1, num_frames=60)
    assert positions.shape == (60, 22, 3) and positions.dtype == np.float32
    parents = np.array(HUMANML3D.parents[1:])
    lengths = np.linalg.norm(positions[:, 1:] - positions[:, parents], axis=-1)
    np.testing.assert_allclose(lengths, np.tile(HUMANML3D.bone_lengths[1:], (60, 1)), atol=1e-5)
    np.testing.assert_allclose(positions[..., 1].min(axis=1), 0, atol=1e-6)
    assert np.linalg.norm(np.diff(positions, axis=0), axis=-1).max() * 20 < 12


@pytest.mark.parametrize("seed", range(5))
def test_motions_do_what_their_label_says(seed):
    facts = {kind: measure(make_motion(kind, seed=seed), fps=20.0) for kind in KINDS}
    assert facts["walk"].forward > 1 and abs(facts["walk"].turn) < 20
    assert 70 < facts["walk-turn-left"].turn < 110
    assert -110 < facts["walk-turn-right"].turn < -70
    for hand, side in enumerate(("left", "right")):
        raised, waved = facts[f"raise-up-{side}-hand"], facts[f"wave-{side}-hand"]
        assert raised.above_head[hand] > 0.1 > 0 > raised.above_shoulder[1 - hand]
        assert waved.above_shoulder[hand] > 0 > waved.above_shoulder[1 - hand]
        assert waved.waves >= 1 and raised.travel < 0.1
    assert min(facts["raise-up-both-hands"].above_head) > 0.1
    assert min(facts["wave-both-hands"].above_shoulder) > 0
    pelvis = make_motion("squat", seed=seed)[:, 0, 1]
    assert pelvis.max() - pelvis.min() > 0.2


@pytest.mark.parametrize("write", [write_synthetic_dataset, write_scaled_dataset])
@pytest.mark.parametrize("seed", [-1, 2**32])
def test_seeds_that_cannot_be_used_are_refused(write, seed, tmp_path):
    with pytest.raises(UserError, match=rf"^seed: {seed} is not between 0 and 4294967295$"):
        write(tmp_path / "data", num_clips=20, seed=seed)
    assert not (tmp_path / "data").exists()


def test_the_seed_decides():
    np.testing.assert_array_equal(make_motion("walk", seed=4), make_motion("walk", seed=4))
    assert (
        make_motion("walk", seed=4, num_frames=50)[10, 20, 2] != make_motion("walk", seed=5, num_frames=50)[10, 20, 2]
    )


def test_folder_is_complete_and_repeatable(synthetic_folder, tmp_path):
    report = write_synthetic_dataset(tmp_path / "again", num_clips=20, seed=3)
    assert report.num_clips == 40 == sum(report.split_sizes.values())
    assert min(report.split_sizes.values()) > 0
    for file in sorted(path for path in (tmp_path / "again").rglob("*") if path.is_file()):
        assert (synthetic_folder / file.relative_to(tmp_path / "again")).read_bytes() == file.read_bytes()
    words = " ".join(c.text for clip in open_dataset(synthetic_folder).clips("train") for c in clip.captions)
    assert "left" in words and "squat" in words
    assert json.dumps(report.split_sizes)


def test_refusals(tmp_path, synthetic_folder):
    with pytest.raises(UserError, match="somersault"):
        make_motion("somersault", seed=0)
    with pytest.raises(UserError, match="exists already"):
        write_synthetic_dataset(synthetic_folder)
    with pytest.raises(UserError, match="is not a whole number from 20 to 100,000"):
        write_synthetic_dataset(tmp_path / "few", num_clips=3)
    assert not (tmp_path / "few").exists()
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file").touch()
    with pytest.raises(UserError, match="exists already"):
        write_synthetic_dataset(tmp_path / "taken")
    shutil.rmtree(tmp_path / "taken")
    assert list(Path(tmp_path).iterdir()) == []


def test_an_empty_folder_may_be_the_destination(tmp_path):
    write_synthetic_dataset(tmp_path, num_clips=20)
    assert open_dataset(tmp_path).names("train")
    assert not list(tmp_path.parent.glob(f".{tmp_path.name}*")), "a partial folder is left"
