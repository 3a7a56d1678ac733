"""Mutated files and flipped bits: a sample of what `make soak` tries."""

import shutil

import pytest

from tests.fuzz import attack
from tests.fuzz.soak import CORPUS
from tests.fuzz.targets import FILES, FOLDERS, make_files

pytestmark = pytest.mark.slow

INPUTS = 30
FOLDER_INPUTS = 15
FLIPS = 10
"""Of each target: some seconds for all."""


# After a checkpoint was refused, a thread of Orbax may still report to its event loop, which is closed.
LATE_REPORTS = pytest.mark.filterwarnings("ignore:Exception ignored in:pytest.PytestUnraisableExceptionWarning")

NEVER_REFUSED = {"run/train.csv"}
"""A damaged log must not keep a run from going on: what can be read of it is kept."""
READ = {
    "train.csv-cut",
    "train.csv-latin1",
    "train.csv-long-number",
    "dataset.yaml-date",
    "motion.glb-long-rotations",
    "table.csv-number",
}
"""Inputs that were bugs and are read now, in place of being refused; a table reports such a row."""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    make_files(folder)
    return folder


@pytest.fixture
def copy(files, tmp_path):
    return shutil.copytree(files, tmp_path / "files")


@pytest.mark.parametrize("name", FILES)
def test_mutated_files_are_read_or_refused(files, name):
    FILES[name](files)
    refused = attack.attack_file(files, name, FILES[name], seed=0, count=INPUTS)
    assert (refused == 0) == (name in NEVER_REFUSED)


@LATE_REPORTS
@pytest.mark.parametrize("name", [name for name in FOLDERS if "cache" not in name])
def test_mutated_folders_are_read_or_refused(files, name):
    assert attack.attack_folder(files, name, FOLDERS[name], seed=0, count=FOLDER_INPUTS) > 0


@LATE_REPORTS
@pytest.mark.parametrize("name", FOLDERS)
def test_no_flipped_bit_is_loaded(files, name):
    refused = attack.flip_bits(files, name, FOLDERS[name], seed=0, count=FLIPS)
    # A damaged cache is made again.
    assert refused == (0 if "cache" in name else FLIPS)


@pytest.mark.parametrize("path", sorted(CORPUS.rglob("*.*")), ids=lambda path: path.name)
def test_inputs_that_were_bugs(copy, path):
    """Their names are `TARGET-what`, in which TARGET is an entry of `FILES` without folders."""
    target = path.name.partition("-")[0]
    (name,) = [name for name in FILES if name.endswith(target)]
    (copy / name).write_bytes(path.read_bytes())
    was_refused = attack.check(lambda: FILES[name](copy), copy)
    assert was_refused == (path.name not in READ)
