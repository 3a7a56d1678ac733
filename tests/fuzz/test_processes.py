"""Some of the kills and races of `make soak`."""

import pytest

from tests.fuzz.processes import COMMANDS, kill_often, prepare, race_often

pytestmark = pytest.mark.release


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("processes")
    prepare(folder)
    return folder


@pytest.mark.parametrize("group", COMMANDS)
def test_what_is_killed_is_whole_and_can_go_on(folder, group):
    assert len(list(kill_often(folder, group, seed=0, count=3))) == 3


def test_one_of_two_processes_wins(folder):
    assert len(list(race_often(folder, count=2))) == 2
