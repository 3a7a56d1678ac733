import pytest

from t2m_jax.errors import UserError
from t2m_jax.files import atomic_file


def test_an_interrupted_write_keeps_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic_file(path) as part:
        part.write_text("half of the n")
        raise KeyboardInterrupt
    assert [file.name for file in tmp_path.iterdir()] == ["a.txt"] and path.read_text() == "old"
    with atomic_file(path) as part:
        part.write_text("new")
        assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["a.txt"] and path.read_text() == "new"


def test_a_full_disk_is_one_line(tmp_path):
    with (
        pytest.raises(UserError, match=r"a\.txt: cannot be written \(No space left on device\)"),
        atomic_file(tmp_path / "a.txt"),
    ):
        raise OSError(28, "No space left on device")
