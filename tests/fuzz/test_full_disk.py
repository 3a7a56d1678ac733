"""Commands on a disk that becomes full."""

import os

import pytest

from tests.fuzz.full_disk import all_commands, fill, small_disk
from tests.fuzz.processes import prepare

pytestmark = pytest.mark.slow
COMMANDS = {" ".join(command.arguments[:2]) + f" {command.result}": command for command in all_commands()}
# Trainings take a minute each; what they write is written by the others, too.
LONG = {name for name in COMMANDS if name.startswith("train") or name.endswith(".bvh")}
NAMES = [pytest.param(name, marks=[pytest.mark.release] if name in LONG else []) for name in COMMANDS]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("full")
    prepare(folder)
    return folder


@pytest.mark.skipif(os.name != "posix", reason="there is no way to limit the space")
@pytest.mark.parametrize("name", NAMES)
def test_a_full_disk_is_one_line(folder, name):
    with small_disk(folder / "disk") as disk:
        assert "error" in fill(folder, disk, COMMANDS[name], 0.3)
