import concurrent.futures
import json
import logging
import os
import shutil
import time
import zlib

import numpy as np
import platformdirs
import pytest

from t2m_jax.data import cache
from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.cache import CACHE_FILE, CACHE_FOLDER, open_clips
from t2m_jax.data.files import FEATURES, TEXTS
from t2m_jax.data.folder import open_dataset
from t2m_jax.errors import UserError
from t2m_jax.motion.skeleton import KIT_ML

WIDTH = KIT_ML.feature_dim
SPLITS = {"train": ("c", "Mc", "a", "Ma", "e", "Me"), "val": ("b",), "test": ("d", "gone")}
LENGTHS = {"a": 30, "Ma": 30, "b": 7, "c": 41, "Mc": 41, "d": 3, "e": 12, "Me": 12, "unlisted": 5}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of KIT-ML's layout, with a clip that is in no list and one that is only in a list."""
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda name: str(tmp_path / "user" / name))
    folder = tmp_path / "data"
    (folder / FEATURES).mkdir(parents=True)
    (folder / TEXTS).mkdir()
    generator = np.random.default_rng(0)
    for name, length in LENGTHS.items():
        np.save(folder / FEATURES / f"{name}.npy", generator.normal(size=(length, WIDTH)).astype(np.float32))
        (folder / TEXTS / f"{name}.txt").write_text(f"{name} walks#{name}/X walk/VERB#0.0#0.0\nso#so/X#1.0#2.5\n")
    for split, names in SPLITS.items():
        (folder / f"{split}.txt").write_text("\n".join(names))
    np.save(folder / "Mean.npy", np.zeros(WIDTH, np.float32))
    np.save(folder / "Std.npy", np.ones(WIDTH, np.float32))
    return folder


def read(folder):
    return open_clips(folder, feature_dim=WIDTH)


def check_whole(folder):
    """Checks every clip against its files."""
    cached = read(folder)
    assert cached.spans.keys() == LENGTHS.keys()
    for name, (first, last) in cached.spans.items():
        np.testing.assert_array_equal(cached.frames[first:last], np.load(folder / FEATURES / f"{name}.npy"))
        assert cached.captions(name) == open_dataset(folder).captions(name)


def files(folder):
    return sorted(path.name for path in (folder / CACHE_FOLDER).iterdir())


def place(folder):
    return folder / CACHE_FOLDER / CACHE_FILE


def test_the_cache_holds_what_the_files_hold(folder):
    check_whole(folder)
    check_whole(folder)
    assert files(folder) == [CACHE_FILE]


def test_training_clips_come_first_and_are_aligned_read_only_views_of_one_array(folder):
    clips = open_dataset(folder).clips("train")
    whole = clips[0].features.base
    assert clips[0].features.ctypes.data == whole.ctypes.data and whole.ctypes.data % 64 == 0
    end = whole.ctypes.data
    for clip in clips:
        assert clip.features.base is whole and not clip.features.flags.writeable
        assert clip.features.ctypes.data == end
        end += clip.features.nbytes
    assert len(whole) == sum(LENGTHS.values())


def test_files_are_read_once(folder, monkeypatch):
    read(folder)
    monkeypatch.setattr(cache, "clip_or_reason", lambda *_, **__: pytest.fail("a clip was read again"))
    assert [clip.name for clip in open_dataset(folder).clips("val")] == ["b"]


def test_lists_may_change_without_reading_again(folder, monkeypatch):
    read(folder)
    monkeypatch.setattr(cache, "clip_or_reason", lambda *_, **__: pytest.fail("a clip was read again"))
    (folder / "train.txt").write_text("e\nunlisted\na\n")
    assert [clip.name for clip in open_dataset(folder).clips("train")] == ["e", "unlisted", "a"]


def change_motion(folder):
    np.save(folder / FEATURES / "a.npy", np.zeros((30, WIDTH), np.float32))


def touch(folder):
    os.utime(folder / FEATURES / "a.npy", ns=(0, time.time_ns()))


@pytest.mark.parametrize(
    "change",
    [
        change_motion,
        touch,
        lambda folder: (folder / TEXTS / "a.txt").write_text("new#new/ADJ#0.0#0.0\n"),
        lambda folder: (folder / FEATURES / "unlisted.npy").unlink(),
        lambda folder: shutil.copy(folder / FEATURES / "a.npy", folder / FEATURES / "new.npy"),
    ],
    ids=["motion", "time", "caption", "one less", "one more"],
)
def test_a_cache_of_changed_files_is_made_anew(folder, change, caplog):
    read(folder)
    change(folder)
    with caplog.at_level(logging.WARNING):
        clips = {clip.name: clip for clip in open_dataset(folder).clips("train")}
    assert [record.message for record in caplog.records] == [
        f"{place(folder)}: the data set has changed since; the cache is made anew"
    ]
    np.testing.assert_array_equal(clips["a"].features, np.load(folder / FEATURES / "a.npy"))
    assert clips["a"].captions == open_dataset(folder).captions("a")


def test_another_width_is_another_cache(folder):
    read(folder)
    assert set(open_clips(folder, feature_dim=263).left_out.values()) == {f"with {WIDTH} features in place of 263"}


def with_index(content, text):
    """The file with another index, its checksum right."""
    num_bytes = cache._FOOTER.unpack(content[-cache._FOOTER.size :])[1]
    return content[:num_bytes] + text + cache._FOOTER.pack(cache._MAGIC, num_bytes, len(text), zlib.crc32(text))


def rewritten_index(content, change):
    *_, num_bytes, index_bytes, _ = cache._FOOTER.unpack(content[-cache._FOOTER.size :])
    return with_index(content, json.dumps(change(json.loads(content[num_bytes:][:index_bytes]))).encode())


def flipped(content, position):
    position %= len(content)
    return content[:position] + bytes([content[position] ^ 16]) + content[position + 1 :]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda content: b"",
        lambda content: content[:-1],
        lambda content: content[: len(content) // 2],
        lambda content: content + b"x",
        lambda content: bytes(len(content)),
        lambda content: flipped(content, 0),
        lambda content: flipped(content, 181 * WIDTH * 4 - 1),  # the last byte of the frames
        lambda content: flipped(content, 181 * WIDTH * 4 + 300),
        lambda content: flipped(content, -cache._FOOTER.size),
        lambda content: flipped(content, -1),
        lambda content: content.replace(b"t2mclip1", b"t2mclip0"),
        lambda content: rewritten_index(content, lambda index: []),
        lambda content: rewritten_index(content, lambda index: index | {"clips": [["a", 181, 5]]}),
        lambda content: rewritten_index(content, lambda index: index | {"clips": [["a", 181, [["too", "few"]]]]}),
        lambda content: rewritten_index(content, lambda index: index | {"clips": [["a", -1, []], ["b", 182, []]]}),
        lambda content: rewritten_index(content, lambda index: index | {"checksums": []}),
        lambda content: rewritten_index(content, lambda index: index | {"width": "wide"}),
        lambda content: rewritten_index(content, lambda index: index | {"clips": [["a", 181, [["a", 5, 0.0, 0.0]]]]}),
        lambda content: rewritten_index(content, lambda index: index | {"left_out": []}),
        lambda content: with_index(content, b"[" * 100_000),
        lambda content: with_index(content, b"\xff"),
    ],
)
def test_a_damaged_cache_is_made_anew(folder, spoil, caplog):
    read(folder)
    content = place(folder).read_bytes()
    place(folder).write_bytes(spoil(content))
    with caplog.at_level(logging.WARNING):
        check_whole(folder)
    assert len(caplog.records) == 1 and "the cache is made anew" in caplog.text
    assert place(folder).read_bytes() == content


def test_every_bit_counts(folder):
    read(folder)
    content, sources = place(folder).read_bytes(), cache.scan_sources(folder, feature_dim=WIDTH)
    for position in np.random.default_rng(0).integers(len(content), size=60):
        place(folder).write_bytes(flipped(content, int(position)))
        assert cache.damage(place(folder), sources)
    place(folder).write_bytes(content)
    assert cache.damage(place(folder), sources) == ""


def test_opening_looks_at_a_sample_and_the_audit_at_everything(folder, monkeypatch):
    monkeypatch.setattr(cache, "BLOCK", 4096)
    monkeypatch.setattr(cache, "BLOCKS_AT_OPENING", 3)
    read(folder)
    content = place(folder).read_bytes()
    place(folder).write_bytes(flipped(content, 3 * 4096))
    read(folder)
    (problem,) = [problem for problem in audit_dataset(folder).problems if CACHE_FILE in problem]
    assert problem == f"{place(folder)}: damaged at byte 12288 or behind it; delete the file, it is made anew from " + (
        "the data set"
    )
    for position in (0, 181 * WIDTH * 4 - 1):
        place(folder).write_bytes(flipped(content, position))
        read(folder)
        assert place(folder).read_bytes() == content


def test_a_stale_cache_is_no_problem(folder):
    read(folder)
    touch(folder)
    assert not any(CACHE_FILE in problem for problem in audit_dataset(folder).problems)


def test_an_interrupted_build_leaves_nothing(folder, monkeypatch):
    def interrupt(_, name, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(cache, "clip_or_reason", interrupt)
        read(folder)
    assert files(folder) == []
    check_whole(folder)


def test_what_a_killed_build_left_is_deleted_and_a_running_one_is_not(folder):
    (folder / CACHE_FOLDER).mkdir()
    left, running = (folder / CACHE_FOLDER / f"{CACHE_FILE}.{name}.partial" for name in ("1", "2"))
    left.write_bytes(b"half")
    running.write_bytes(b"half")
    os.utime(left, (0, 0))
    read(folder)
    assert files(folder) == [CACHE_FILE, running.name]


def test_many_readers_at_once_all_get_the_clips(folder):
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        for future in [pool.submit(check_whole, folder) for _ in range(8)]:
            future.result()
    assert files(folder) == [CACHE_FILE]


def test_an_open_cache_outlives_its_file(folder):
    clips = open_dataset(folder).clips("train")
    before = [clip.features.copy() for clip in clips]
    change_motion(folder)
    read(folder)
    shutil.rmtree(folder / CACHE_FOLDER)
    for clip, features in zip(clips, before, strict=True):
        np.testing.assert_array_equal(clip.features, features)


def test_without_room_beside_the_data_the_users_cache_folder_serves(folder, tmp_path, monkeypatch):
    (folder / CACHE_FOLDER).write_text("a file where the folder should be")
    check_whole(folder)
    (own,) = (tmp_path / "user" / "t2m_jax" / "clips").iterdir()
    monkeypatch.setattr(cache, "clip_or_reason", lambda *_, **__: pytest.fail("a clip was read again"))
    check_whole(folder)
    own.unlink()
    own.parent.rmdir()
    own.parent.write_text("and here as well")
    with pytest.raises(UserError, match=r"no room for the cache .*clips\.cache nor at"):
        read(folder)


def test_a_folder_without_any_usable_clip_has_an_empty_cache(folder):
    shutil.rmtree(folder / TEXTS)
    cached = read(folder)
    assert cached.frames.shape == (0, WIDTH) and cached.left_out.keys() == LENGTHS.keys()
    with pytest.raises(UserError, match="6 of 6 clips cannot be used: 6 without caption file"):
        open_dataset(folder).clips("train")
