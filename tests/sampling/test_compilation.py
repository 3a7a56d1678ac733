"""Where compiled programs are kept."""

import os

import jax
import platformdirs
import pytest

from t2m_jax.sampling import compilation
from t2m_jax.sampling.compilation import DISABLE_VARIABLE, use_compilation_cache

OPTIONS = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")


@pytest.fixture(autouse=True)
def configured(monkeypatch, tmp_path):
    """Gives every test an unconfigured JAX and a cache folder of its own, and puts things back."""
    before = {name: jax.config.values[name] for name in OPTIONS}
    jax.config.update("jax_compilation_cache_dir", None)
    monkeypatch.delenv(DISABLE_VARIABLE, raising=False)
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda name: str(tmp_path / "cache" / name))
    yield
    for name, value in before.items():
        jax.config.update(name, value)


def test_programs_are_kept_in_the_users_cache_folder(tmp_path):
    folder = use_compilation_cache()
    assert folder == tmp_path / "cache" / "t2m_jax" / "xla"
    assert folder.is_dir()
    assert jax.config.values["jax_compilation_cache_dir"] == str(folder)


def test_a_folder_the_user_chose_is_left_alone(tmp_path):
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "mine"))
    assert use_compilation_cache() == tmp_path / "mine"
    assert not (tmp_path / "cache").exists()


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="the system has no modes of files")
@pytest.mark.parametrize("chosen", [False, True])
@pytest.mark.parametrize("place", ["cache/t2m_jax/xla", "cache"])
def test_a_folder_in_which_others_can_write_is_not_used(tmp_path, caplog, chosen, place):
    folder = tmp_path / "cache" / "t2m_jax" / "xla"
    folder.mkdir(parents=True)
    (tmp_path / place).chmod(0o777)
    jax.config.update("jax_compilation_cache_dir", str(folder) if chosen else None)
    assert use_compilation_cache() is None
    assert jax.config.values["jax_compilation_cache_dir"] is None
    assert f"{folder}: compiled programs are not kept or read here: " in caplog.text and "can write in" in caplog.text


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="the system has no modes of files")
def test_a_folder_of_somebody_else_is_not_used(tmp_path, caplog, monkeypatch):
    assert use_compilation_cache().stat().st_mode & 0o777 == 0o700
    monkeypatch.setattr(compilation, "SYSTEM", -1)
    monkeypatch.setattr(os, "getuid", lambda: os.geteuid() + 1)
    assert use_compilation_cache() is None and "belongs to somebody else" in caplog.text


def test_it_can_be_turned_off(monkeypatch, tmp_path):
    monkeypatch.setenv(DISABLE_VARIABLE, "1")
    assert use_compilation_cache() is None
    assert not (tmp_path / "cache").exists()


def test_a_folder_that_cannot_be_made_is_done_without(tmp_path):
    (tmp_path / "cache").write_text("a file in the way")
    assert use_compilation_cache() is None
    assert jax.config.values["jax_compilation_cache_dir"] is None
