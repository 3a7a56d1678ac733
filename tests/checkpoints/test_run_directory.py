"""Run directories: what is written comes back, and what is broken is refused by name."""

import dataclasses
import random
import shutil
import subprocess
import sys
import threading
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.audit import audit_model
from t2m_jax.checkpoints.run import (
    CHECKPOINTS,
    CONFIG_FILE,
    FORMAT_VERSION,
    INFO_FILE,
    Checkpoints,
    create_run,
    is_run,
    restore_latest,
    run_info,
)
from t2m_jax.config import load_config
from t2m_jax.errors import UserError
from t2m_jax.files.writing import PARTIAL
from t2m_jax.train.checks import read_run_config


class State(NamedTuple):
    """Something like a training state."""

    step: jax.Array
    params: dict
    ready: jax.Array


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Something like a training config."""

    width: int = 3
    """A number."""


def state_at(step) -> State:
    weights = np.random.default_rng(step).normal(size=(5, 3)).astype(np.float32)
    params = {"layer": {"kernel": jnp.asarray(weights), "bias": jnp.full(3, 1e-30 * step)}}
    return State(jnp.array(step, jnp.int32), params, jnp.array(True))


def save(run, *steps, keep=None):
    with Checkpoints(run, keep=keep) as checkpoints:
        for step in steps:
            checkpoints.save(step, state_at(step))


def restore(run, like=None):
    with Checkpoints(run) as checkpoints:
        like = state_at(0) if like is None else like
        return type(like)(**checkpoints.restore_fields(like._asdict()))


def assert_same(state, other):
    for one, another in zip(jax.tree.leaves(state), jax.tree.leaves(other), strict=True):
        assert one.dtype == another.dtype
        np.testing.assert_array_equal(one, another)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    run = tmp_path_factory.mktemp("runs") / "run"
    run.mkdir()
    create_run(run, "vqvae", Config(width=7))
    save(run, 3, 6)
    return run


@pytest.fixture
def copy(saved, tmp_path):
    shutil.copytree(saved, tmp_path / "run")
    return tmp_path / "run"


def test_a_run_says_what_it_is(saved):
    assert is_run(saved)
    assert run_info(saved).kind == "vqvae"
    assert load_config(saved / CONFIG_FILE, Config) == Config(width=7)


def test_a_changed_byte_of_the_config_shows(copy):
    path = copy / CONFIG_FILE
    whole = path.read_bytes()
    assert read_run_config(copy, Config) == Config(width=7)
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(UserError, match=rf"{CONFIG_FILE}: has changed since it was written, or is damaged"):
            read_run_config(copy, Config)
    assert [part.name for part in audit_model(copy) if CONFIG_FILE in part.problem] == [CONFIG_FILE]


def test_a_config_without_a_checksum_is_refused(copy):
    (copy / CONFIG_FILE).write_text("width: 8", encoding="utf-8")
    with pytest.raises(UserError, match="has changed since"):
        read_run_config(copy, Config)


def test_an_interrupted_start_can_be_repeated(tmp_path):
    (tmp_path / "interrupted").mkdir()
    (tmp_path / "interrupted" / CONFIG_FILE).write_text("width: 1", encoding="utf-8")
    create_run(tmp_path / "interrupted", "gpt", Config())
    assert run_info(tmp_path / "interrupted").kind == "gpt"


def test_the_newest_checkpoint_comes_back_bit_for_bit(saved):
    assert_same(restore(saved), state_at(6))
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), state_at(0))
    assert_same(restore(saved, shapes), state_at(6))


def test_some_fields_can_be_had_alone(saved):
    with Checkpoints(saved) as checkpoints:
        found = checkpoints.restore_fields({"params": state_at(0).params})
    assert_same(found, {"params": state_at(6).params})


def test_a_step_is_written_once(copy):
    (before,) = (copy / CHECKPOINTS / "6").glob("_CHECKPOINT_METADATA")
    written = before.stat().st_mtime_ns
    save(copy, 6)
    assert before.stat().st_mtime_ns == written


@pytest.mark.parametrize(("keep", "left"), [(None, ["1", "2", "3"]), (1, ["3"]), (2, ["2", "3"])])
def test_old_checkpoints_go(tmp_path, keep, left):
    save(tmp_path, 1, 2, 3, keep=keep)
    assert sorted(path.name for path in (tmp_path / CHECKPOINTS).iterdir()) == left


def test_a_kill_while_an_old_checkpoint_is_deleted_leaves_no_half_of_it(tmp_path, monkeypatch):
    def killed(folder, **_):
        monkeypatch.undo()
        (folder / "_CHECKPOINT_METADATA").unlink()

    with Checkpoints(tmp_path, keep=1) as checkpoints:
        checkpoints.save(1, state_at(1))
        assert checkpoints.steps() == [1]
        monkeypatch.setattr(shutil, "rmtree", killed)
        checkpoints.save(2, state_at(2))
        assert checkpoints.steps() == [2]
        assert len(list((tmp_path / CHECKPOINTS).iterdir())) == 2  # what is left of the first
        checkpoints.save(3, state_at(3))
    assert [path.name for path in (tmp_path / CHECKPOINTS).iterdir()] == ["3"]


def test_without_a_checkpoint_a_run_starts_from_its_first_state(tmp_path, saved):
    first = state_at(0)
    assert restore_latest(tmp_path, first) is first
    assert_same(restore_latest(saved, first), state_at(6))
    with pytest.raises(UserError, match="no checkpoint yet"):
        restore(tmp_path / "other")


def test_what_a_crash_left_half_written_is_no_checkpoint(copy):
    """The newest but one counts; the leftovers go with the next write and are in nobody's way."""
    shutil.copytree(copy / CHECKPOINTS / "6", copy / CHECKPOINTS / "9.orbax-checkpoint-tmp-0")
    (copy / CHECKPOINTS / "9.orbax-checkpoint-tmp-0" / "_CHECKPOINT_METADATA").unlink()
    assert_same(restore(copy), state_at(6))
    save(copy, 9)
    assert_same(restore(copy), state_at(9))
    assert {path.name for path in (copy / CHECKPOINTS).iterdir()} >= {"3", "6", "9"}


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "not a run directory"),
        ("format_version: 4", "missing field 'kind'"),
        ("kind: gan\nformat_version: 99", "format_version 99"),
        ("kind: gpt\nformat_version: 4\nextra: 1", "unknown key 'extra'"),
        ("kind: [", "cannot read this YAML"),
    ],
)
def test_folders_that_are_no_run_are_named(copy, content, says):
    (copy / INFO_FILE).unlink()
    if content is not None:
        (copy / INFO_FILE).write_text(content, encoding="utf-8")
    with pytest.raises(UserError, match=says) as caught:
        run_info(copy)
    assert str(copy) in str(caught.value)


@pytest.mark.parametrize("content", ["kind: gpt\n", "kind: gpt\nformat_version: 3\n"])
def test_runs_of_older_formats_are_refused(copy, content):
    (copy / INFO_FILE).write_text(content, encoding="utf-8")
    version = 3 if "3" in content else 1
    with pytest.raises(UserError) as caught:
        run_info(copy)
    advice = "use it with t2m_jax 0.1, or make it again"
    assert f"{caught.value}" == f"{copy / INFO_FILE}: format_version {version} is of an older t2m_jax; {advice}"


def test_new_runs_have_todays_format(saved, tmp_path):
    assert run_info(saved).format_version == FORMAT_VERSION == 4
    assert "format_version: 4" in (saved / INFO_FILE).read_text(encoding="utf-8")
    with pytest.raises(UserError, match="not a run directory"):
        run_info(tmp_path)


def test_what_is_saved_is_what_the_state_was(tmp_path):
    """Saving goes on while the next update writes into the donated state."""
    update = jax.jit(lambda state: jax.tree.map(lambda leaf: leaf + leaf, state), donate_argnums=0)
    state = state_at(1)
    with Checkpoints(tmp_path) as checkpoints:
        for step in (1, 2, 3):
            checkpoints.save(step, state)
            state = update(state)
    for step in (1, 2, 3):
        with Checkpoints(tmp_path) as checkpoints:
            found = checkpoints.restore_step(step, state_at(0)._asdict())["params"]["layer"]["kernel"]
        np.testing.assert_array_equal(found, 2 ** (step - 1) * state_at(1).params["layer"]["kernel"])


def test_a_checkpoint_comes_back_on_the_devices_of_the_state(saved):
    """Otherwise the updates of a resumed run would be compiled again."""
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:1]), ("data",))
    sharding = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec())
    found = restore_latest(saved, jax.device_put(state_at(0), sharding))
    assert_same(found, state_at(6))
    assert {leaf.sharding for leaf in jax.tree.leaves(found)} == {sharding}


def refusal(run, like=None) -> str:
    """Returns the one line with which a run's newest checkpoint is refused, nothing where it loads unharmed."""
    try:
        state = restore(run, like)
    except UserError as error:
        assert str(run) in str(error)
        assert "\n" not in str(error)
        return str(error)
    assert_same(state, state_at(6))
    return ""


def refuse_other_models(run) -> None:
    """Fails where a state of other shapes or names is taken for that of the run."""
    for layer in (
        {"layer": {"kernel": jnp.zeros((5, 4)), "bias": jnp.zeros(3)}},
        {"other": {"kernel": jnp.zeros((5, 3)), "bias": jnp.zeros(3)}},
        {"layer": {"kernel": jnp.zeros((5, 3))}},
    ):
        assert "checkpoint 6 is damaged or does not fit its config" in refusal(run, state_at(0)._replace(params=layer))


def damages(whole: bytes, draws: random.Random) -> list[bytes | None]:
    """Returns a file's contents with a bit flipped, cut off, and None for a lost file."""
    bit = draws.randrange(8 * len(whole))
    flipped = bytearray(whole)
    flipped[bit // 8] ^= 1 << bit % 8
    return [bytes(flipped), whole[: draws.randrange(len(whole))], None]


@pytest.mark.slow
def test_the_newest_intact_checkpoint_is_used_whatever_is_damaged(copy, caplog):
    files = [path for path in sorted((copy / CHECKPOINTS / "6").rglob("*")) if path.is_file()]
    draws = random.Random(0)
    for path in files:
        whole = path.read_bytes()
        for damaged in damages(whole, draws):
            path.unlink() if damaged is None else path.write_bytes(damaged)
            caplog.clear()
            assert_same(restore(copy), state_at(3))
            assert str(path) in caplog.text and "checkpoint 3 is used instead" in caplog.text
        path.write_bytes(whole)
    assert_same(restore(copy), state_at(6))
    (copy / CHECKPOINTS / "3" / "_CHECKPOINT_METADATA").unlink()
    files[0].unlink()
    with pytest.raises(UserError, match=f"{files[0].name}: there is no such file"):
        restore(copy)


def test_a_resumed_run_sets_damaged_checkpoints_aside(copy, caplog):
    (copy / CHECKPOINTS / "6" / "manifest.txt").write_text("damaged")
    assert_same(restore_latest(copy, state_at(0)), state_at(3))
    kept = sorted(path.name.rpartition("-")[0] or path.name for path in (copy / CHECKPOINTS).iterdir())
    assert kept == ["3", "damaged-6"]
    assert "6/manifest.txt: damaged" in caplog.text and "checkpoint 6 is set aside as damaged-6-" in caplog.text
    save(copy, 6)
    assert_same(restore(copy), state_at(6))


def test_a_run_does_not_start_over_because_all_its_checkpoints_are_damaged(copy):
    for step in ("3", "6"):
        (copy / CHECKPOINTS / step / "manifest.txt").write_text("damaged")
    for _ in range(2):
        with pytest.raises(UserError, match=r"6/manifest\.txt: damaged; .* \(no older checkpoint is intact\)"):
            restore_latest(copy, state_at(0))


def test_what_is_written_late_after_a_failure_is_deleted_too(copy):
    late = copy / CHECKPOINTS / f".9{PARTIAL}"

    def write_again():
        while late.exists():
            time.sleep(0.01)
        time.sleep(0.15)
        late.mkdir()

    with Checkpoints(copy) as checkpoints:
        checkpoints.save(8, state_at(8))
        late.mkdir()
        thread = threading.Thread(target=write_again)
        thread.start()
    thread.join()
    assert not late.exists()


def test_checkpoints_of_a_stage_in_a_run_need_manifests(copy):
    shutil.copytree(copy / CHECKPOINTS, copy / "movement" / CHECKPOINTS)
    (copy / "movement" / CHECKPOINTS / "6" / "manifest.txt").unlink()
    with Checkpoints(copy / "movement") as checkpoints:
        assert "manifest.txt" in checkpoints.damage(6) and not checkpoints.damage(3)


@pytest.mark.slow
@pytest.mark.parametrize("check", [refuse_other_models])
def test_checkpoints_that_do_not_fit_are_refused(copy, check):
    # In a process of its own: Orbax's readers that were under way when another failed complain until the very end.
    program = f"""
from pathlib import Path
from tests.checkpoints.test_run_directory import {check.__name__}
{check.__name__}(Path({str(copy)!r}))
"""
    command = [sys.executable, "-W", "ignore", "-c", program]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert result.returncode == 0, result.stderr
