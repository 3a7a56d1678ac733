import concurrent.futures
import io
import json
import logging
import os
import shutil
import threading
import time

import numpy as np
import platformdirs
import pytest
from filelock import FileLock

from t2m_jax.data import cache
from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.cache import CACHE_FOLDER, CACHE_NAME, FRAMES, INDEX, open_clips
from t2m_jax.data.files import FEATURES, TEXTS
from t2m_jax.data.folder import open_dataset
from t2m_jax.errors import UserError
from t2m_jax.files.locks import SECONDS
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
    return folder / CACHE_FOLDER / CACHE_NAME


def contents(folder):
    return {file: (place(folder) / file).read_bytes() for file in (FRAMES, INDEX)}


def test_the_cache_holds_what_the_files_hold(folder):
    check_whole(folder)
    check_whole(folder)
    assert files(folder) == [CACHE_NAME]
    assert sorted(path.name for path in place(folder).iterdir()) == [FRAMES, INDEX]


def test_the_frames_are_an_ordinary_npy_file(folder):
    frames = read(folder).frames
    np.testing.assert_array_equal(np.load(place(folder) / FRAMES), frames)
    assert frames.shape == (sum(LENGTHS.values()), WIDTH) and frames.dtype == np.float32


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
def test_a_cache_of_changed_files_is_rebuilt(folder, change, caplog):
    read(folder)
    change(folder)
    with caplog.at_level(logging.WARNING):
        clips = {clip.name: clip for clip in open_dataset(folder).clips("train")}
    assert [record.message for record in caplog.records] == [
        f"{place(folder)}: the data set has changed since; the cache is rebuilt"
    ]
    np.testing.assert_array_equal(clips["a"].features, np.load(folder / FEATURES / "a.npy"))
    assert clips["a"].captions == open_dataset(folder).captions("a")


def test_another_width_is_another_cache(folder):
    read(folder)
    assert set(open_clips(folder, feature_dim=263).left_out.values()) == {f"with {WIDTH} features in place of 263"}


def flipped(content, position):
    position %= len(content)
    return content[:position] + bytes([content[position] ^ 16]) + content[position + 1 :]


def rewritten(**changes):
    """Changes the index and makes its checksum right."""

    def change(content):
        index = json.loads(content) | changes
        del index["checksum"]
        return json.dumps(index | {"checksum": cache._checksum(index)}).encode()

    return change


def with_header(**changes):
    """Changes the header of the frames."""

    def change(content):
        file = io.BytesIO(content)
        header = {"descr": "<f4", "fortran_order": False, "shape": (181, WIDTH)} | changes
        np.lib.format.write_array_header_1_0(file, header)
        return file.getvalue()

    return change


@pytest.mark.parametrize(
    ("file", "spoil"),
    [
        *(
            (file, spoil)
            for file in (FRAMES, INDEX)
            for spoil in (
                lambda content: b"",
                lambda content: content[:-1],
                lambda content: content[: len(content) // 2],
                lambda content: content + b"x",
                lambda content: bytes(len(content)),
                lambda content: flipped(content, 0),
                lambda content: flipped(content, 300),
                lambda content: flipped(content, -1),
                lambda content: None,
            )
        ),
        (INDEX, lambda content: b"[]"),
        (INDEX, lambda content: b"7"),
        (INDEX, lambda content: b"[" * 100_000),
        (INDEX, lambda content: b"\xff"),
        (INDEX, lambda content: content.replace(b'"fingerprint"', b'"fingerprunt"')),
        (INDEX, rewritten(clips=5)),
        (INDEX, rewritten(clips=[["a", 181, 5]])),
        (INDEX, rewritten(clips=[["a", 181, [["too", "few"]]]])),
        (INDEX, rewritten(clips=[["a", -1, []], ["b", 182, []]])),
        (INDEX, rewritten(clips=[["a", 180, []]])),
        (INDEX, rewritten(clips=[["a", "181", []]])),
        (INDEX, rewritten(clips=[["a", 181, [["a", 5, 0.0, 0.0]]]])),
        (INDEX, rewritten(clips=[[["a"], 181, []]])),
        (INDEX, rewritten(blocks=[])),
        (INDEX, rewritten(blocks="wide")),
        (INDEX, rewritten(left_out=[])),
        (INDEX, rewritten(broken_captions={"a": "one"})),
    ],
)
def test_a_damaged_cache_is_rebuilt(folder, file, spoil, caplog):
    read(folder)
    before = contents(folder)
    spoiled = spoil(before[file])
    if spoiled is None:
        (place(folder) / file).unlink()
    else:
        (place(folder) / file).write_bytes(spoiled)
    with caplog.at_level(logging.WARNING):
        check_whole(folder)
    assert len(caplog.records) == 1 and "the cache is rebuilt" in caplog.text
    assert contents(folder) == before


@pytest.mark.parametrize(
    "change",
    [
        with_header(shape=(182, WIDTH)),
        with_header(shape=(WIDTH, 181)),
        with_header(shape=(10**7, 10**9)),
        with_header(fortran_order=True),
        with_header(descr="<f2"),
        with_header(descr="|O"),
        lambda content: content[:-4],
        lambda content: content[:128],
        lambda content: content[:100],
    ],
)
def test_another_array_is_refused_whatever_its_checksums_say(folder, change, monkeypatch):
    read(folder)
    (place(folder) / FRAMES).write_bytes(change(contents(folder)[FRAMES]))
    monkeypatch.setattr(cache, "_blocks_of", lambda *_: [])
    with pytest.raises(cache._UnusableError):
        cache.load_cache(place(folder), cache.scan_sources(folder, feature_dim=WIDTH))


def test_every_bit_counts(folder):
    read(folder)
    sources = cache.scan_sources(folder, feature_dim=WIDTH)
    generator = np.random.default_rng(0)
    for file, content in contents(folder).items():
        for position in (*generator.integers(len(content), size=40), *generator.integers(128, size=10)):
            (place(folder) / file).write_bytes(flipped(content, int(position)))
            assert cache.damage(place(folder), folder, sources)
        (place(folder) / file).write_bytes(content)
        assert cache.damage(place(folder), folder, sources) == ""


def test_the_frames_that_are_read_are_checked_and_the_audit_checks_all(folder, monkeypatch):
    monkeypatch.setattr(cache, "BLOCK", 4096)
    first, end = read(folder).spans["b"]
    content = contents(folder)[FRAMES]
    for row in (first, end - 1):
        before_the_end = (len(read(folder).frames) - row) * 4 * WIDTH
        (place(folder) / FRAMES).write_bytes(flipped(content, len(content) - before_the_end))
        (clip,) = open_dataset(folder).clips("val")
        np.testing.assert_array_equal(clip.features, np.load(folder / FEATURES / "b.npy"))
        assert contents(folder)[FRAMES] == content
    (place(folder) / FRAMES).write_bytes(flipped(content, 3 * 4096))
    read(folder)
    (problem,) = [problem for problem in audit_dataset(folder).problems if CACHE_FOLDER in problem]
    assert problem == (
        f"{place(folder)}: its frames are damaged at byte 12288 or later; delete it, and it will be rebuilt"
    )
    (place(folder) / FRAMES).write_bytes(flipped(content, 0))
    read(folder)
    assert contents(folder)[FRAMES] == content


def test_a_stale_cache_is_no_problem(folder):
    read(folder)
    touch(folder)
    assert not any(CACHE_FOLDER in problem for problem in audit_dataset(folder).problems)


@pytest.mark.parametrize("file", [f"{FEATURES}/a.npy", f"{TEXTS}/a.txt"])
def test_the_audit_finds_a_file_that_changed_with_size_and_time_kept(folder, file):
    read(folder)
    assert not any(CACHE_FOLDER in problem for problem in audit_dataset(folder).problems)
    status = (folder / file).stat()
    (folder / file).write_bytes(flipped((folder / file).read_bytes(), -3))
    os.utime(folder / file, ns=(status.st_atime_ns, status.st_mtime_ns))
    (problem,) = [problem for problem in audit_dataset(folder).problems if CACHE_FOLDER in problem]
    assert "the files of clip a have changed since, with their size and time kept; delete it" in problem


def test_a_cache_of_an_older_version_is_made_again(folder, caplog):
    read(folder)
    index = json.loads(contents(folder)[INDEX])
    del index["files"], index["checksum"]
    (place(folder) / INDEX).write_text(json.dumps(index | {"checksum": cache._checksum(index)}))
    check_whole(folder)
    assert "made by an older version; the cache is rebuilt" in caplog.text


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
    left, running = (folder / CACHE_FOLDER / f".{CACHE_NAME}.{name}.partial" for name in ("1", "2"))
    for partial in (left, running):
        partial.mkdir()
        (partial / FRAMES).write_bytes(b"half")
        os.utime(partial, (0, 0))
    os.utime(left / FRAMES, (0, 0))
    read(folder)
    assert files(folder) == [running.name, CACHE_NAME]


def test_a_reader_waits_for_the_process_that_writes_the_cache(folder, tmp_path):
    read(folder)
    finished, hidden = place(folder), folder / "hidden"
    finished.rename(hidden)
    # Another lock than that of `t2m_jax.files.locks`, as in another process.
    holder = FileLock(finished.with_name(f".{CACHE_NAME}.lock"), thread_local=False)

    def finish():
        hidden.rename(finished)
        holder.release()

    holder.acquire()
    made = hidden.stat().st_ino
    other = threading.Timer(3 * SECONDS, finish)
    other.start()
    check_whole(folder)
    other.join()
    assert finished.stat().st_ino == made and not (tmp_path / "user").exists(), "the reader made its own"


def test_a_reader_does_not_wait_forever(folder, monkeypatch):
    monkeypatch.setattr(cache, "WAIT_SECONDS", 0.0)
    (folder / CACHE_FOLDER).mkdir()
    monkeypatch.setattr(cache, "cache_places", lambda folder: [folder / CACHE_FOLDER / CACHE_NAME] * 2)
    lock_file = place(folder).with_name(f".{CACHE_NAME}.lock")
    with FileLock(lock_file):
        lock_file.write_text("123\nsomewhere-else\n")
        with pytest.raises(UserError, match="is being written by process 123 on somewhere-else"):
            read(folder)


def test_many_readers_at_once_all_get_the_clips(folder):
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        for future in [pool.submit(check_whole, folder) for _ in range(8)]:
            future.result()
    assert files(folder) == [CACHE_NAME]


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
    shutil.rmtree(own.parent)
    own.parent.write_text("and here as well")
    with pytest.raises(UserError, match=r"no room for the cache of its clips: it cannot be written .*; nor at .*clips"):
        read(folder)


def test_a_folder_without_any_usable_clip_has_an_empty_cache(folder):
    shutil.rmtree(folder / TEXTS)
    cached = read(folder)
    assert cached.frames.shape == (0, WIDTH) and cached.left_out.keys() == LENGTHS.keys()
    with pytest.raises(UserError, match="6 of 6 clips cannot be used: 6 without caption file"):
        open_dataset(folder).clips("train")
