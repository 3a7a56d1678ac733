import gc

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data.banks.motions import batch_at, compact, draw_cuts, make_bank, windows_at
from t2m_jax.data.folder import Clip
from t2m_jax.errors import UserError
from t2m_jax.motion.normalizer import Normalizer
from tests.jit import assert_jit_equals_eager

WINDOW = 16
LENGTHS = (16, 40, 7, 25, 17, 9)


def make_clips(width=5):
    """Clips whose every value tells clip and frame: 1000 * clip + frame + 1."""
    return [
        Clip(
            f"clip{number}",
            (1000.0 * number + np.arange(1, length + 1, dtype=np.float32))[:, None] * np.ones((1, width), np.float32),
            (),
        )
        for number, length in enumerate(LENGTHS)
    ]


@pytest.fixture(scope="module")
def bank():
    return jax.device_put(make_bank(make_clips(), Normalizer(np.zeros(5, np.float32), np.ones(5, np.float32))))


def noise_clips(num_clips=6, *, width=263, seed=0):
    """Clips of noise, read-only views of one array with other frames before, between and after them."""
    generator = np.random.default_rng(seed)
    whole = generator.normal(size=(400, width)).astype(np.float32)
    whole.flags.writeable = False
    starts = 37 + 50 * np.arange(num_clips)
    lengths = generator.integers(40, 50, num_clips)
    return [
        Clip(f"clip{start}", whole[start : start + length], ()) for start, length in zip(starts, lengths, strict=True)
    ]


def noise_normalizer(width=263):
    generator = np.random.default_rng(1)
    return Normalizer(
        generator.normal(size=width).astype(np.float32), generator.uniform(0.01, 3, width).astype(np.float32)
    )


def cut_windows(bank, clips, keys, *, window):
    """One window from each of the given clips."""
    return windows_at(bank, 0, draw_cuts(bank, clips, keys, window=window), window=window)


def copied(clips):
    """The same clips, each an array of its own."""
    return [clip._replace(features=clip.features.copy()) for clip in clips]


@pytest.mark.parametrize("own", [False, True], ids=["views", "arrays"])
def test_bank_holds_the_clips_as_they_are(own):
    clips = copied(noise_clips()) if own else noise_clips()
    made = make_bank(clips, noise_normalizer())
    for clip, start, length in zip(clips, made.starts, made.lengths, strict=True):
        np.testing.assert_array_equal(made.frames[start : start + length], clip.features)


def test_views_of_a_mapped_file_are_not_copied(tmp_path):
    clips = noise_clips()
    np.save(tmp_path / "frames.npy", clips[0].features.base)
    whole = np.load(tmp_path / "frames.npy", mmap_mode="r")
    clips = [clip._replace(features=whole[start:][:20]) for clip, start in zip(clips, (77, 37, 57), strict=False)]
    made = make_bank(clips, noise_normalizer())
    # The mapped memory itself, from the last row before the first clip that is a multiple of 16 rows down the file.
    assert made.frames.ctypes.data == whole.ctypes.data + 32 * whole.strides[0]
    assert len(made.frames) == 97 - 32
    expected = np.array(whole[32:97])
    del whole, clips
    gc.collect()
    np.testing.assert_array_equal(made.frames, expected)


@pytest.mark.parametrize(("num_used", "is_copied"), [(6, False), (5, False), (4, True), (2, True)])
def test_a_small_share_of_an_array_is_copied_for_a_device(num_used, is_copied):
    whole = np.random.default_rng(0).normal(size=(6 * 16, 4)).astype(np.float32)
    whole.flags.writeable = False
    clips = [Clip(f"{number}", whole[16 * number :][:16], ()) for number in (0, 5, 1, 4, 2, 3)][:num_used]
    made = make_bank(clips, noise_normalizer(4))
    assert made.frames.base is whole
    made = compact(made)
    assert len(made.frames) == 16 * (num_used if is_copied else 6)
    for clip, start in zip(clips, made.starts, strict=True):
        np.testing.assert_array_equal(made.frames[start : start + 16], clip.features)


def test_arrays_that_somebody_may_write_to_are_copied(tmp_path):
    whole = np.lib.format.open_memmap(tmp_path / "frames.npy", "w+", np.float32, (40, 5))
    made = make_bank([Clip("a", whole[:16], ()), Clip("b", whole[16:], ())], noise_normalizer(5))
    whole[:] = 1
    assert not np.any(made.frames)


@pytest.mark.parametrize("own", [False, True], ids=["views", "arrays"])
def test_windows_are_those_of_clips_normalized_first_to_the_last_bit(own):
    clips, normalizer, keys = noise_clips(), noise_normalizer(), jax.random.split(jax.random.key(4), 6)
    made = make_bank(copied(clips) if own else clips, normalizer)
    chosen = np.array([5, 0, 3, 1, 2, 4])
    cut = jax.jit(cut_windows, static_argnames="window")(made, chosen, keys, window=WINDOW)
    for row, (number, key) in enumerate(zip(chosen, keys, strict=True)):
        offset = int(jax.random.randint(key, (), 0, max(made.lengths[number] - WINDOW, 0) + 1))
        expected = normalizer.normalize(clips[number].features)[offset : offset + WINDOW]
        np.testing.assert_array_equal(cut.motion[row, : len(expected)], expected)
        assert cut.mask[row].sum() == len(expected)


def test_windows_never_show_a_neighbour_and_pad_with_zeros(bank):
    clips = jnp.arange(len(LENGTHS))
    for seed in range(20):
        windows = cut_windows(bank, clips, jax.random.split(jax.random.key(seed), len(LENGTHS)), window=WINDOW)
        for number, length in enumerate(LENGTHS):
            values = np.asarray(windows.motion[number, :, 0])
            mask = np.asarray(windows.mask[number])
            assert mask.sum() == min(length, WINDOW)
            assert mask[: mask.sum()].all()
            assert (values[~mask] == 0).all()
            frames = values[mask] - 1000 * number
            assert frames[0] >= 1 and frames[-1] <= length
            np.testing.assert_array_equal(np.diff(frames), 1)
            if length <= WINDOW:
                assert frames[0] == 1


def test_every_start_is_drawn_also_the_last(bank):
    clips = jnp.full(4000, 4)
    keys = jax.random.split(jax.random.key(0), len(clips))
    starts = np.asarray(cut_windows(bank, clips, keys, window=WINDOW).motion[:, 0, 0]) - 4001
    assert set(starts) == {0, 1}
    assert abs(starts.mean() - 0.5) < 0.05


def test_the_last_clip_is_not_clamped(bank):
    window = cut_windows(bank, jnp.array([5]), jax.random.key(0)[None], window=WINDOW)
    np.testing.assert_array_equal(window.motion[0, :9, 0], 5000 + np.arange(1, 10))


def test_a_window_does_not_depend_on_the_others(bank):
    clips, keys = jnp.array([1, 3, 1, 4]), jax.random.split(jax.random.key(2), 4)
    together = cut_windows(bank, clips, keys, window=4)
    alone = [cut_windows(bank, clips[row : row + 1], keys[row : row + 1], window=4) for row in range(4)]
    np.testing.assert_array_equal(together.motion, jnp.concatenate([windows.motion for windows in alone]))
    assert not np.array_equal(together.motion[0], together.motion[2])


@pytest.mark.slow
def test_a_batch_is_a_pure_function_of_key_and_step(bank):
    key = jax.random.key(9)
    jitted = jax.jit(batch_at, static_argnames=("batch_size", "window"))
    for step in (0, 3):
        plain = batch_at(bank, key, step, batch_size=2, window=WINDOW)
        again = jitted(bank, key, jnp.int32(step), batch_size=2, window=WINDOW)
        np.testing.assert_array_equal(plain.motion, again.motion)
        np.testing.assert_array_equal(plain.mask, again.mask)
    other = batch_at(bank, key, 4, batch_size=2, window=WINDOW)
    assert not np.array_equal(plain.motion, other.motion)


def test_no_clips_is_a_user_error():
    with pytest.raises(UserError, match="no clips"):
        make_bank([], Normalizer(np.zeros(5), np.ones(5)))


def test_statistics_of_other_features_are_a_user_error(bank):
    with pytest.raises(UserError, match="5 features, the statistics 4"):
        make_bank(make_clips(), Normalizer(np.zeros(4), np.ones(4)))


@pytest.mark.slow
def test_windows_are_the_same_without_jit(bank):
    clips, keys = jnp.array([1, 2]), jax.random.split(jax.random.key(3), 2)
    assert_jit_equals_eager(jax.jit(cut_windows, static_argnames="window"), bank, clips, keys, rtol=0, window=4)
