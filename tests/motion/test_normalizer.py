import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion.normalizer import (
    Normalizer,
    load_normalizer,
    normalizer_from_clips,
    save_normalizer,
    weighted_normalizer,
)
from t2m_jax.motion.skeleton import make_layout
from tests.jit import assert_jit_equals_eager

LAYOUT = make_layout(3)
in_both_libraries = pytest.mark.parametrize("asarray", [np.asarray, jnp.asarray], ids=["numpy", "jax"])


def random_clips(offset=0.0):
    generator = np.random.default_rng(0)
    return [generator.normal(offset, 2, (n, LAYOUT.feature_dim)).astype(np.float32) for n in (1, 7, 40)]


@pytest.mark.parametrize("joints", [22, 21])
def test_like_the_reference(golden_dir, joints):
    reference, layout = np.load(golden_dir / "motion" / f"stats_grouping{joints}.npz"), make_layout(joints)
    clips = np.split(reference["clips"], np.cumsum(reference["lengths"])[:-1])
    assert not np.isfinite(reference["clips"]).all()  # one clip is to be left out
    normalizer = normalizer_from_clips(clips, layout)
    np.testing.assert_allclose(normalizer.mean, reference["mean"], atol=2e-5)
    np.testing.assert_allclose(normalizer.std, reference["std"], rtol=1e-6)
    for factor, name in ((5.0, "std_feat_bias5_once"), (25.0, "std_feat_bias5_twice")):
        weighted = weighted_normalizer(normalizer, layout, factor=factor)
        np.testing.assert_allclose(weighted.std, reference[name], rtol=1e-6)
        np.testing.assert_array_equal(weighted.mean, normalizer.mean)


def test_far_from_zero_the_deviation_keeps_its_digits():
    near, far = (normalizer_from_clips(iter(random_clips(offset)), LAYOUT) for offset in (0.0, 1000.0))
    np.testing.assert_allclose(far.mean, near.mean + 1000, rtol=1e-6)
    np.testing.assert_allclose(far.std, near.std, rtol=1e-4)


@in_both_libraries
def test_normalized_frames_have_mean_0_and_deviation_1_a_group(asarray):
    clips = random_clips(3.0)
    normalizer = normalizer_from_clips(clips, LAYOUT)
    motion = np.asarray(normalizer.normalize(asarray(np.concatenate(clips))))
    np.testing.assert_allclose(motion.mean(0), 0, atol=1e-5)
    for group in LAYOUT:
        np.testing.assert_allclose(motion.std(0)[group].mean(), 1, rtol=1e-5)


@in_both_libraries
def test_denormalizing_undoes_normalizing(asarray):
    normalizer, motion = normalizer_from_clips(random_clips(), LAYOUT), asarray(np.stack([random_clips()[2]] * 2))
    there = normalizer.normalize(motion)
    back = normalizer.denormalize(there)
    assert isinstance(there, np.ndarray) == isinstance(back, np.ndarray) == (asarray is np.asarray)
    assert there.dtype == back.dtype == np.float32
    np.testing.assert_allclose(back, motion, atol=1e-5)


def test_a_normalizer_is_a_tree_of_arrays():
    normalizer, motion = normalizer_from_clips(random_clips(), LAYOUT), jnp.asarray(random_clips()[1])
    assert_jit_equals_eager(jax.jit(Normalizer.normalize), jax.tree.map(jnp.asarray, normalizer), motion, atol=1e-5)


def test_a_group_that_never_changes_gets_1():
    clip = random_clips()[2]
    clip[:, LAYOUT.contacts] = 1
    normalizer = normalizer_from_clips([clip], LAYOUT)
    np.testing.assert_array_equal(normalizer.std[LAYOUT.contacts], 1)
    np.testing.assert_array_equal(normalizer.normalize(clip)[:, LAYOUT.contacts], 0)


def test_what_cannot_be_measured_is_refused():
    broken = random_clips()[1]
    broken[3, 4] = np.inf
    with pytest.raises(UserError, match="no clip with finite features"):
        normalizer_from_clips([broken], LAYOUT)
    with pytest.raises(UserError, match="a clip has 263 features, but 35 are expected"):
        normalizer_from_clips([np.zeros((4, 263), np.float32)], LAYOUT)
    with pytest.raises(UserError, match="motion has 34 features, but the statistics have 35"):
        normalizer_from_clips(random_clips(), LAYOUT).normalize(np.zeros((4, 34), np.float32))


def test_files_give_the_statistics_back(tmp_path):
    normalizer = normalizer_from_clips(random_clips(), LAYOUT)
    save_normalizer(tmp_path / "new" / "folder", normalizer)
    loaded = load_normalizer(tmp_path / "new" / "folder")
    np.testing.assert_array_equal(loaded.mean, normalizer.mean)
    np.testing.assert_array_equal(loaded.std, normalizer.std)


def test_broken_files_are_refused(tmp_path):
    normalizer = normalizer_from_clips(random_clips(), LAYOUT)
    with pytest.raises(UserError, match=r"Mean.npy: there is no such file"):
        load_normalizer(tmp_path)
    save_normalizer(tmp_path, normalizer)
    for std, message in (
        (normalizer.std[:-1], "Mean.npy has 35 columns, but Std.npy has 34"),
        (np.where(np.arange(35) == 2, 0, normalizer.std), "Std.npy: column 2 is not above zero"),
        (np.where(np.arange(35) == 3, np.nan, normalizer.std), "Std.npy: column 3 is not a finite"),
        (np.where(np.arange(35) == 3, 1e300, 1.0), "Std.npy: column 3 is not a finite"),
        (np.arange(35), "Std.npy: does not hold one array of floating-point numbers"),
        (normalizer.std[None], "Std.npy: has shape .*; expected one row of floating-point numbers"),
    ):
        np.save(tmp_path / "Std.npy", std)
        with pytest.raises(UserError, match=message):
            load_normalizer(tmp_path)
    (tmp_path / "Std.npy").write_text("no array")
    with pytest.raises(UserError, match=r"Std.npy: is not a complete .npy file"):
        load_normalizer(tmp_path)


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="file: cannot be created"):
        save_normalizer(tmp_path / "file", normalizer_from_clips(random_clips(), LAYOUT))
