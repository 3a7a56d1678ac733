"""Motions that stay on the host: the same batches as from a bank on the devices, and a bounded memory."""

import gc
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data.banks.captions import CaptionBank, caption_batch_at, caption_cuts_at, make_caption_bank
from t2m_jax.data.banks.host import FeedPlan, HostWindows, release_pages
from t2m_jax.data.banks.motions import FedFrames, batch_at, cuts_at, make_bank
from t2m_jax.data.folder import Clip
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.text.word_vectors import Vocabulary
from tests.conftest import resident_memory

WIDTH, WINDOW, BATCH = 6, 16, 4
LENGTHS = (16, 40, 7, 25, 17, 9, 30, 12, 21, 5, 33)
"""Two steps per epoch, and clips that are left over."""
VOCABULARY = Vocabulary(("sos", "eos", "unk", "a", "b", "c"))


def mapped_clips(folder):
    """Clips in a mapped file; the last one ends with the file."""
    generator = np.random.default_rng(0)
    np.save(folder / "frames.npy", generator.normal(size=(20 + sum(LENGTHS), WIDTH)).astype(np.float32))
    whole = np.asarray(np.load(folder / "frames.npy", mmap_mode="r"))
    ends = 20 + np.cumsum(LENGTHS)
    captions = [tuple(Caption("x", (word,) * count) for word in "abc"[:count]) for count in (1, 2, 3) * 4]
    return [
        Clip(f"{end}", whole[end - length : end], said)
        for end, length, said in zip(ends, LENGTHS, captions, strict=False)
    ]


def normalizer():
    generator = np.random.default_rng(1)
    return Normalizer(*generator.uniform(0.1, 3, (2, WIDTH)).astype(np.float32))


def window_case(folder):
    options = {"key": jax.random.key(4), "batch_size": BATCH, "window": WINDOW}
    bank = make_bank(mapped_clips(folder), normalizer())
    plan = FeedPlan(lambda bank, step: cuts_at(bank, step=step, **options), WINDOW)
    return bank, plan, lambda bank, step: batch_at(bank, step=step, **options)


def caption_case(folder):
    options = {"key": jax.random.key(4), "batch_size": BATCH, "window": WINDOW}
    bank = make_caption_bank(mapped_clips(folder), normalizer(), VOCABULARY)
    plan = FeedPlan(lambda bank, step: caption_cuts_at(bank, step=step, **options), WINDOW)
    return bank, plan, lambda bank, step: caption_batch_at(bank, step=step, **options)


def fed(data, first_step, windows):
    """The data as a device has them: without frames, with some windows."""
    frames = FedFrames(np.array(first_step, np.int32), windows)
    if isinstance(data, CaptionBank):
        return data._replace(motions=data.motions._replace(frames=frames))
    return data._replace(frames=frames)


@pytest.mark.slow
@pytest.mark.parametrize("make_case", [window_case, caption_case])
@pytest.mark.parametrize(("first_step", "size"), [(0, 1), (0, 5), (3, 1), (3, 5)])
def test_batches_are_those_of_a_bank_on_the_device_to_the_last_bit(tmp_path, make_case, first_step, size):
    data, plan, batch = make_case(tmp_path)
    batch = jax.jit(batch)
    seen = []
    with HostWindows(data, plan, rows=np.arange(BATCH)).read(first_step, first_step + 10, ahead=3) as steps:
        for start in range(first_step, first_step + 10, size):
            part = fed(data, start, np.stack([next(steps) for _ in range(size)]))
            for step in range(start, start + size):
                expected = batch(data, jnp.int32(step))
                jax.tree.map(np.testing.assert_array_equal, batch(part, jnp.int32(step)), expected)
                seen.append(np.asarray(expected.motion))
        assert next(steps, None) is None
    assert len({motion.tobytes() for motion in seen}) == 10


def test_a_process_cuts_its_own_rows(tmp_path):
    data, plan, _ = window_case(tmp_path)
    whole, part = (HostWindows(data, plan, rows=np.array(rows)).cut(5) for rows in (range(BATCH), (1, 3)))
    np.testing.assert_array_equal(part, whole[[1, 3]])


def test_an_error_of_a_thread_is_raised(tmp_path, monkeypatch):
    windows = HostWindows(*window_case(tmp_path)[:2], rows=np.arange(BATCH))
    monkeypatch.setattr(windows, "_first_rows", lambda data, step: 1 / 0)
    with windows.read(0, 5, ahead=2) as steps, pytest.raises(ZeroDivisionError):
        next(steps)


def test_without_the_cpu_a_user_error_tells_what_to_do(tmp_path, monkeypatch):
    def unknown(backend):
        raise RuntimeError(f"Unknown backend {backend}")

    data, plan, _ = window_case(tmp_path)
    monkeypatch.setattr(jax, "local_devices", unknown)
    with pytest.raises(UserError, match="JAX_PLATFORMS"):
        HostWindows(data, plan, rows=np.arange(BATCH))


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not report the memory of a process")
def test_read_pages_do_not_count_as_memory(tmp_path):
    np.save(tmp_path / "frames.npy", np.ones((2**20, 64), np.float32))
    whole = np.asarray(np.load(tmp_path / "frames.npy", mmap_mode="r"))
    gc.collect()
    before = resident_memory()
    assert whole[1000:].sum() > 0
    assert resident_memory() - before > 200e6
    release_pages(whole[1000:])
    assert resident_memory() - before < 50e6
    assert whole[1000:].sum() > 0


def test_arrays_in_memory_are_not_released(tmp_path):
    written = np.lib.format.open_memmap(tmp_path / "frames.npy", "w+", np.float32, (4000, 5))
    written[:] = 2
    for array in (written, np.full(5, 2.0), np.load(tmp_path / "frames.npy", mmap_mode="c")):
        array[:] = 3
        release_pages(array)
        np.testing.assert_array_equal(array, 3)
