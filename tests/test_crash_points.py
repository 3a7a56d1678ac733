"""Writers whose system calls fail, one after another: what was there stays, and nothing unfinished remains."""

import contextlib
import errno
import functools
import os
import shutil
import sys

import numpy as np
import pytest

from t2m_jax.checkpoints.best import Best, find_best, restore_trained, save_best
from t2m_jax.checkpoints.bundle import load_bundle, save_bundle
from t2m_jax.checkpoints.evaluator import load_trained_evaluator, save_evaluator
from t2m_jax.errors import UserError
from t2m_jax.files.writing import save_json
from tests.tiny import random_bundle, random_evaluator

pytestmark = pytest.mark.slow

CALLS = ("fsync", "replace", "rename", "mkdir", "open", "chmod")
"""Functions of `os` with which writers change the disk."""
FIELDS = {"params": {"a": np.arange(4.0)}}


def write_file(folder):
    save_json(folder / "report.json", {"new": 1})


BUNDLE, EVALUATOR = functools.cache(random_bundle), functools.cache(random_evaluator)


def write_bundle(folder):
    save_bundle(folder / "bundle", BUNDLE(), card="# tiny\n")
    load_bundle(folder / "bundle")


def write_evaluator(folder):
    save_evaluator(folder / "evaluator", EVALUATOR())
    load_trained_evaluator(folder / "evaluator")


def write_best(folder):
    save_best(folder, Best(step=6, metric="loss", value=0.5), FIELDS)


@pytest.fixture
def start(tmp_path):
    """A folder with older contents."""
    (tmp_path / "start").mkdir()
    save_json(tmp_path / "start" / "report.json", {"old": 1})
    save_best(tmp_path / "start", Best(step=3, metric="loss", value=1.0), FIELDS)
    return tmp_path / "start"


def contents(folder):
    return {f"{path.relative_to(folder)}": path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@contextlib.contextmanager
def failing(name, number):
    """Lets the call `number` of a function of `os` fail; yields a list that is then not empty."""
    original, seen, failed = getattr(os, name), [0], []

    def call(*arguments, **options):
        seen[0] += 1
        if seen[0] == number:
            failed.append(number)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "somewhere")
        return original(*arguments, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, name, call)
        yield failed


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("write", [write_file, write_bundle, write_evaluator, write_best])
def test_a_failed_call_leaves_the_old_contents(start, tmp_path, write, name):
    shutil.copytree(start, tmp_path / "whole")
    write(tmp_path / "whole")
    for number in range(1, 1000):
        folder = shutil.copytree(start, tmp_path / f"{number}")
        with failing(name, number) as failed:
            try:
                write(folder)
            except UserError as error:
                assert "No space left" in str(error) and "\n" not in str(error)
                assert contents(folder) == contents(start)
            else:
                # Whatever failed did not matter: older best weights that cannot be deleted, for example.
                whole = contents(tmp_path / "whole")
                assert {name: value for name, value in contents(folder).items() if name in whole} == whole
        assert find_best(folder) is not None
        np.testing.assert_array_equal(restore_trained(folder, FIELDS)["params"]["a"], FIELDS["params"]["a"])
        if not failed:
            break
        if contents(folder) == contents(start):
            write(folder)  # trying again works
    assert not failed, "it never came to an end"


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_contents_are_on_the_disk_before_they_get_their_name(tmp_path, monkeypatch):
    done = []

    def watch(name, describe):
        original = getattr(os, name)
        monkeypatch.setattr(os, name, lambda *args: done.append(describe(*args)) or original(*args))

    watch("fsync", lambda number: f"fsync {os.path.basename(os.readlink(f'/proc/self/fd/{number}'))}")
    watch("replace", lambda source, path: f"replace {os.path.basename(path)}")
    save_json(tmp_path / "report.json", {})
    assert [step.split()[0] for step in done] == ["fsync", "replace", "fsync"]
    assert "partial" in done[0] and done[1:] == ["replace report.json", f"fsync {tmp_path.name}"]
