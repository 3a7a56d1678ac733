"""Files and folders are written whole or not at all, by one process at a time, and damage shows."""

import errno
import hashlib
import os
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock

from t2m_jax.errors import UserError
from t2m_jax.files.locks import lock
from t2m_jax.files.manifest import MANIFEST, check_folder, read_manifest, write_manifest
from t2m_jax.files.reading import MAX_TEXT, load_json, load_text
from t2m_jax.files.writing import ABANDONED_SECONDS, atomic_file, atomic_folder, check_output, claim, save_text


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_an_interrupted_write_keeps_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic_file(path) as part:
        part.write_text("half of the n")
        raise KeyboardInterrupt
    assert names(tmp_path) == ["a.txt"] and path.read_text() == "old"
    with atomic_file(path) as part:
        part.write_text("new")
        assert path.read_text() == "old"
    assert names(tmp_path) == ["a.txt"] and path.read_text() == "new"


def test_the_folder_of_the_user_is_not_replaced(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="is the folder that you are in"), atomic_folder(Path()):
        raise AssertionError
    assert names(tmp_path) == []


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_is_one_line(tmp_path, number):
    for opened in (atomic_file, atomic_folder):
        with pytest.raises(UserError, match=r"a\.txt: cannot be written \(.*\); make room"), opened(tmp_path / "a.txt"):
            raise OSError(number, os.strerror(number))
    assert names(tmp_path) == []


def test_links_stay_links_and_modes_are_kept(tmp_path):
    target, link = tmp_path / "target.txt", tmp_path / "link.txt"
    target.write_text("old")
    target.chmod(0o640)
    link.symlink_to(target)
    with atomic_file(link) as part:
        part.write_text("new")
    assert link.is_symlink() and target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_pipes_are_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe.bvh")
    with pytest.raises(UserError, match=r"pipe\.bvh: cannot be written, it is a pipe or device"):
        check_output(tmp_path / "pipe.bvh")


def test_what_killed_processes_left_is_deleted_later(tmp_path):
    left, young = tmp_path / ".a.txt.0123.partial.txt", tmp_path / ".a.txt.4567.partial.txt"
    half = tmp_path / ".folder.0123.partial"
    half.mkdir()
    for path in (left, young, half / "x"):
        path.write_text("half")
    old = time.time() - 2 * ABANDONED_SECONDS
    for path in (left, half / "x", half):
        os.utime(path, (old, old))
    with claim([tmp_path / "a.txt"]):
        pass
    with atomic_folder(tmp_path / "folder"):
        pass
    assert names(tmp_path) == [young.name, "folder"]


HOLD = """
import sys, pathlib
from t2m_jax.files.locks import lock
with lock(pathlib.Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_one_process_writes_and_the_others_are_told(tmp_path):
    path = tmp_path / "out"
    with subprocess.Popen([sys.executable, "-c", HOLD, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(UserError, match=f"out: is being written by process {other.pid} on ") as error, lock(path):
            pass
        place = tmp_path / ".out.lock"
        host = place.read_text().splitlines()[1]
        assert str(error.value).endswith(f"on {host}; wait until it has finished, or end it")
        with pytest.raises(UserError, match="is being written by"), atomic_folder(path):
            pass
        other.kill()
        other.wait()
        assert names(tmp_path) == [".out.lock"]
    with atomic_folder(path), lock(path):  # the kernel has released the lock, and it is taken again inside
        pass
    assert names(tmp_path) == ["out"]


CONTENTS = [b"", b"\0" * 30, b"12", b"123\nho", b"\xff\xfe\n", b"x" * 5000, b"who\nhost\n", b"123\nelsewhere\n456\n"]


@pytest.mark.parametrize("contents", CONTENTS)
def test_a_lock_file_that_somebody_left_blocks_nobody(tmp_path, contents):
    place = tmp_path / ".out.lock"
    place.write_bytes(contents)
    with lock(tmp_path / "out"):
        assert names(tmp_path) == [".out.lock"]
        assert place.read_text().startswith(f"{os.getpid()}\n")
    assert names(tmp_path) == []


@pytest.mark.parametrize("contents", [b"", b"\xff\xfe\n", b"x" * 5000, b"123\nelsewhere\x1b[31m\n"])
def test_a_lock_that_names_no_owner_excludes_others(tmp_path, contents):
    holder = FileLock(tmp_path / ".out.lock")  # another lock than that of this module, as in another process
    with holder:
        (tmp_path / ".out.lock").write_bytes(contents)
        owner = r"process 123 on elsewhere\x1b[31m" if b"\x1b" in contents else "another process"
        with pytest.raises(UserError) as error, lock(tmp_path / "out"):
            pass
    assert str(error.value) == f"{tmp_path / 'out'}: is being written by {owner}; wait until it has finished, or end it"


def test_who_waits_for_a_lock_finds_that_its_file_was_deleted(tmp_path):
    """Otherwise a process that has opened the old file and one that creates a new one would both have the lock."""
    program = """
import fcntl, os, pathlib, sys
from t2m_jax.files.locks import lock
path = pathlib.Path(sys.argv[1])
lock_file, flock = fcntl.flock, fcntl.LOCK_EX
def late(descriptor, how, seen=[]):
    if how & flock and not seen:
        seen.append(1)
        print("opened", flush=True)
        sys.stdin.readline()
    return lock_file(descriptor, how)
fcntl.flock = late
with lock(path):
    print("held", os.path.exists(path.with_name(".out.lock")), flush=True)
"""
    command = [sys.executable, "-c", program, tmp_path / "out"]
    with lock(tmp_path / "out"):
        other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert other.stdout.readline() == "opened\n"
    assert names(tmp_path) == []
    assert other.communicate("go\n", timeout=60)[0] == "held True\n"
    assert names(tmp_path) == []


def test_a_pipe_in_the_place_of_the_lock_file_is_kept_and_blocks_nobody(tmp_path):
    os.mkfifo(tmp_path / ".out.lock")
    with lock(tmp_path / "out"):
        pass
    assert names(tmp_path) == [".out.lock"]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc")
def test_a_folder_that_takes_no_file_is_not_said_to_be_in_use():
    said = r"^/proc/x.npz: cannot be written \(.+\); choose another place$"
    with pytest.raises(UserError, match=said), claim([Path("/proc/x.npz")]):
        pass


def test_long_names_do_not_share_a_lock(tmp_path):
    first, second = (tmp_path / f"{'walk' * 60}{number}" for number in (1, 2))
    with lock(first):
        assert len(names(tmp_path)) == 1
        with lock(second):
            assert len(names(tmp_path)) == 2


@pytest.fixture
def listed(tmp_path):
    folder = tmp_path / "listed"
    (folder / "deep" / "er").mkdir(parents=True)
    (folder / "a.txt").write_text("some text")
    (folder / "deep" / "er" / "b.bin").write_bytes(bytes(range(256)) * 50)
    write_manifest(folder)
    return folder


def test_a_manifest_lists_all_files(listed):
    assert list(read_manifest(listed)) == ["a.txt", "deep/er/b.bin"]
    check_folder(listed)
    check_folder(listed, thorough=True)


@pytest.mark.parametrize("thorough", [False, True])
def test_every_flipped_bit_shows(listed, thorough):
    random = np.random.default_rng(0)
    for name in ("a.txt", "deep/er/b.bin", MANIFEST):
        path = listed / name
        sound = path.read_bytes()
        for _ in range(150):
            bit = int(random.integers(8 * len(sound)))
            damaged = bytearray(sound)
            damaged[bit // 8] ^= 1 << bit % 8
            path.write_bytes(damaged)
            with pytest.raises(UserError, match=name):
                check_folder(listed, thorough=thorough)
        path.write_bytes(sound)
    check_folder(listed, thorough=thorough)


@pytest.mark.parametrize(
    "change",
    [
        lambda folder: (folder / "a.txt").unlink(),
        lambda folder: (folder / "a.txt").write_text("some text "),
        lambda folder: (folder / MANIFEST).write_bytes((folder / MANIFEST).read_bytes().replace(b"\n", b"\r\n")),
        lambda folder: (folder / MANIFEST).write_bytes((folder / MANIFEST).read_bytes()[:-70]),
        lambda folder: (folder / MANIFEST).write_bytes(b""),
        lambda folder: (folder / MANIFEST).unlink(),
    ],
)
def test_missing_and_changed_files_show(listed, change):
    change(listed)
    with pytest.raises(UserError):
        check_folder(listed)


def test_texts_that_would_fill_the_memory_are_refused(listed, tmp_path):
    for path, read in ((tmp_path / "a.json", load_json), (tmp_path / "a.txt", load_text), (listed / MANIFEST, None)):
        with path.open("wb") as file:
            file.truncate(MAX_TEXT + 1)  # takes no room on the disk
        with pytest.raises(UserError, match=rf"{path.name}: has 67,108,865 bytes; at most 67,108,864 are read"):
            check_folder(listed) if read is None else read(path)


def test_text_with_half_a_character_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"a\.txt: cannot be written, '\\ud83d' is half a character"):
        save_text(tmp_path / "a.txt", "a \ud83d person")
    assert not names(tmp_path)


def test_a_name_with_a_nul_is_refused():
    with pytest.raises(UserError, match=r"no file can have this name"):
        load_text(Path("a\0b"))


@pytest.mark.skipif(not os.path.isdir("/dev/fd"), reason="pipes have no names")
def test_pipes_that_somebody_gave_are_read():
    end, start = os.pipe()
    os.write(start, b"a man walks")
    os.close(start)
    assert load_text(Path(f"/dev/fd/{end}")) == "a man walks"
    os.close(end)


def test_a_manifest_does_not_lead_out_of_its_folder(listed):
    (listed.parent / "secret").write_text("x")
    (listed / "..secret").write_text("x")
    write_manifest(listed)
    check_folder(listed)  # this name is one of a file inside
    text = (listed / MANIFEST).read_text().replace("..secret", "../secret")
    body = "".join(line + "\n" for line in text.splitlines()[:-1])
    (listed / MANIFEST).write_text(body + hashlib.sha256(body.encode()).hexdigest() + "\n")
    with pytest.raises(UserError, match="damaged"):
        check_folder(listed)
