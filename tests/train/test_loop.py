"""The loop with updates that do nothing: what is logged, validated, kept, and what stops it."""

import csv
import logging
import os
import re
import signal
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from t2m_jax.checkpoints.run import Checkpoints
from t2m_jax.errors import Interruption, UserError
from t2m_jax.train.config import LoopConfig
from t2m_jax.train.log import MetricLog
from t2m_jax.train.loop import (
    Call,
    Measured,
    Measurement,
    Speed,
    join_calls,
    mean_metrics,
    next_multiple,
    run_loop,
    stop_requests,
)


class Counter(NamedTuple):
    """A state that counts, and remembers the last loss."""

    step: jax.Array
    weight: jax.Array


START = Counter(jnp.array(0), jnp.zeros(2))


def counting(bad_step=None, bad_loss=float("nan"), size=1, counts=None):
    """Returns updates whose losses are the numbers of their steps, but for one.

    The metrics have `size` rows as in training. Rows without an update are not finite, so that nobody uses them. The
    list `counts` gets the number of updates of each call.
    """

    def update(state, count):
        assert 1 <= count <= size
        if counts is not None:
            counts.append(count)
        steps = int(state.step) + 1 + np.arange(size)
        losses = np.where(steps == bad_step, bad_loss, steps.astype(np.float32))
        last = losses[count - 1]
        losses[count:] = np.nan
        metrics = {"loss": jnp.asarray(losses), "square": jnp.asarray(losses**2)}
        return Counter(jnp.asarray(steps[count - 1]), jnp.full(2, last)), metrics

    return update


def rows(run, split="train"):
    with (run / f"{split}.csv").open(encoding="utf-8") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


def kept_steps(run):
    return sorted(int(folder.name) for folder in (run / "checkpoints").iterdir())


def every(interval, measure, picture=lambda state: None):
    return Measurement("val", "validation", interval, lambda state: Measured(measure(state), picture(state)))


def loop(num_steps=10, log_every=4, checkpoint_every=5, keep=2, steps_per_call=1):
    return LoopConfig(
        num_steps=num_steps,
        log_every=log_every,
        checkpoint_every=checkpoint_every,
        keep_checkpoints=keep,
        steps_per_call=steps_per_call,
    )


def test_rows_are_means_since_the_row_before(tmp_path):
    state = run_loop(tmp_path, START, counting(), config=loop())
    assert int(state.step) == 10
    assert [row["step"] for row in rows(tmp_path)] == [4, 5, 8, 10]
    assert [row["loss"] for row in rows(tmp_path)] == [2.5, 5.0, 7.0, 9.5]
    assert rows(tmp_path)[0]["square"] == np.mean([1, 4, 9, 16])


def test_validation_sees_the_state_of_its_step(tmp_path):
    def validate(state):
        return {"loss": 100.0 + int(state.step), "weight": float(state.weight[0])}

    run_loop(tmp_path, START, counting(), config=loop(num_steps=7), measurements=[every(3, validate)])
    assert [(row["step"], row["loss"]) for row in rows(tmp_path, "val")] == [(3, 103), (6, 106), (7, 107)]
    assert [row["weight"] for row in rows(tmp_path, "val")] == [3, 6, 7]


def test_validation_can_be_turned_off(tmp_path):
    run_loop(tmp_path, START, counting(), config=loop(), measurements=[every(0, lambda state: {"loss": 1.0})])
    assert not (tmp_path / "val.csv").exists()


def test_the_log_shows_learning_rate_and_speed(tmp_path, caplog):
    speed = Speed(lambda step: 0.5 * step, frames_per_step=64)
    with caplog.at_level(logging.INFO):
        run_loop(tmp_path, START, counting(), config=loop(), speed=speed)
    assert [row["learning_rate"] for row in rows(tmp_path)] == [2.0, 2.5, 4.0, 5.0]
    assert not any("second" in name for name in rows(tmp_path)[0]), "speeds differ from run to run"
    found = [re.search(r"steps_per_second (\S+), frames_per_second (\S+)", message) for message in caplog.messages]
    speeds = [(float(one[1]), float(one[2])) for one in found if one]
    assert len(speeds) == 4
    np.testing.assert_allclose([frames / steps for steps, frames in speeds], 64, rtol=0.01)


def test_a_picture_is_kept_with_each_measurement(tmp_path):
    def picture(state):
        return np.full((8, 6, 3), int(state.step), np.uint8)

    measurement = every(5, lambda state: {"fid": 1.0}, picture)
    run_loop(tmp_path, START, counting(), config=loop(), measurements=[measurement])
    assert sorted(path.name for path in (tmp_path / "pictures").iterdir()) == ["10.png", "5.png"]
    assert np.asarray(Image.open(tmp_path / "pictures" / "5.png")).tolist() == np.full((8, 6, 3), 5).tolist()


@pytest.mark.parametrize(("keep", "expected"), [(1, [10]), (2, [9, 10]), (9, [3, 6, 9, 10])])
def test_the_newest_checkpoints_are_kept(tmp_path, keep, expected):
    run_loop(tmp_path, START, counting(), config=loop(checkpoint_every=3, keep=keep))
    assert kept_steps(tmp_path) == expected
    with Checkpoints(tmp_path) as checkpoints:
        state = START._replace(**checkpoints.restore_fields(START._asdict()))
    assert int(state.step) == 10
    np.testing.assert_array_equal(state.weight, [10.0, 10.0])


def test_the_last_state_is_kept_without_any_interval(tmp_path):
    config = loop(log_every=0, checkpoint_every=0)
    run_loop(tmp_path / "good", START, counting(), config=config)
    assert kept_steps(tmp_path / "good") == [10]
    with pytest.raises(UserError, match="10"):
        run_loop(tmp_path / "bad", START, counting(bad_step=10), config=config)
    assert kept_steps(tmp_path / "bad") == []


@pytest.mark.parametrize(("size", "kept"), [(1, 3), (2, 4)])
def test_when_asked_to_stop_the_state_of_that_moment_is_kept(tmp_path, size, kept):
    with pytest.raises(Interruption, match=f"stopped by SIGTERM after step {kept}, which is kept") as found:
        run_loop(
            tmp_path,
            START,
            counting(size=size),
            config=loop(steps_per_call=size),
            asked_to_stop=lambda step: signal.SIGTERM if step >= 3 else None,
        )
    assert found.value.number == signal.SIGTERM and kept_steps(tmp_path) == [kept]
    with Checkpoints(tmp_path) as checkpoints:
        state = START._replace(**checkpoints.restore_fields(START._asdict()))
    assert int(state.step) == kept
    state = run_loop(tmp_path, state, counting(), config=loop())
    assert int(state.step) == 10
    assert [row["step"] for row in rows(tmp_path)] == sorted({kept, 4, 5, 8, 10})


def test_a_training_that_is_over_needs_no_interruption(tmp_path):
    state = run_loop(tmp_path, START, counting(), config=loop(), asked_to_stop=lambda step: 15 if step == 10 else None)
    assert int(state.step) == 10


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGUSR1"])
def test_signals_are_remembered_and_handlers_restored(name):
    number = getattr(signal, name)
    before = signal.getsignal(number)
    with stop_requests() as asked:
        assert asked(1) is None
        os.kill(os.getpid(), number)
        assert asked(2) == number
    assert signal.getsignal(number) == before


def test_a_second_ctrl_c_interrupts_at_once():
    with pytest.raises(KeyboardInterrupt), stop_requests():
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)


def test_damaged_rows_of_the_log_are_left_out(tmp_path):
    run_loop(tmp_path, START, counting(), config=loop(num_steps=5))
    with (tmp_path / "train.csv").open("a", encoding="utf-8") as file:
        file.write("abc,1,2\n")
    with Checkpoints(tmp_path) as checkpoints:
        state = START._replace(**checkpoints.restore_fields(START._asdict()))
    run_loop(tmp_path, state, counting(), config=loop())
    assert [row["step"] for row in rows(tmp_path)] == [4, 5, 8, 10]


@pytest.mark.parametrize("size", [1, 4])
@pytest.mark.parametrize("bad_loss", [float("nan"), float("inf")])
@pytest.mark.parametrize(
    ("bad_step", "log_every", "kept"),
    [(1, 100, []), (7, 100, [3, 6]), (6, 100, [3]), (7, 1, [3, 6]), (10, 4, [3, 6, 9])],
)
def test_a_loss_that_is_not_finite_stops_with_its_step_and_is_never_kept(
    tmp_path, bad_loss, bad_step, log_every, kept, size
):
    config = loop(log_every=log_every, checkpoint_every=3, keep=9, steps_per_call=size)
    with pytest.raises(UserError, match=rf"^step {bad_step}: the loss is {bad_loss}"):
        run_loop(tmp_path, START, counting(bad_step, bad_loss, size), config=config)
    assert kept_steps(tmp_path) == kept
    if kept:
        assert max(row["step"] for row in rows(tmp_path)) < bad_step


def test_a_run_goes_on_from_a_state(tmp_path):
    run_loop(tmp_path / "whole", START, counting(), config=loop())
    run_loop(tmp_path / "parts", START, counting(), config=loop(num_steps=5))
    with Checkpoints(tmp_path / "parts") as checkpoints:
        middle = START._replace(**checkpoints.restore_fields(START._asdict()))
    run_loop(tmp_path / "parts", middle, counting(), config=loop())
    assert (tmp_path / "parts/train.csv").read_bytes() == (tmp_path / "whole/train.csv").read_bytes()
    assert kept_steps(tmp_path / "parts") == kept_steps(tmp_path / "whole")


def test_a_finished_state_is_left_alone(tmp_path):
    state = run_loop(tmp_path, START, counting(), config=loop())
    written = (tmp_path / "train.csv").read_bytes()
    again = run_loop(tmp_path, state, counting(), config=loop())
    assert again is state
    assert (tmp_path / "train.csv").read_bytes() == written


def test_metrics_of_many_updates_go_to_the_host_before_they_are_logged(tmp_path, monkeypatch):
    monkeypatch.setattr("t2m_jax.train.loop.MOST_CALLS", 3)
    joined = []
    monkeypatch.setattr("t2m_jax.train.loop.join_calls", lambda calls: joined.append(len(calls)) or join_calls(calls))
    run_loop(tmp_path, START, counting(), config=loop(log_every=0, checkpoint_every=0))
    assert max(joined) == 4 and [row["loss"] for row in rows(tmp_path)] == [5.5]


def test_means_are_over_the_steps():
    history = [
        Call({"loss": jnp.array([1.0, 2.0]), "other": jnp.array([2.0, 4.0])}, 2),
        Call({"loss": jnp.array([6.0, jnp.nan]), "other": jnp.array([12.0, 99.0])}, 1),
    ]
    assert mean_metrics(history, first_step=5) == {"loss": 3.0, "other": 6.0}
    history[0].metrics["other"] = jnp.array([2.0, jnp.nan])
    assert np.isnan(mean_metrics(history, first_step=5)["other"])
    history[1].metrics["loss"] = jnp.array([jnp.inf, 1.0])
    with pytest.raises(UserError, match=r"^step 7: "):
        mean_metrics(history, first_step=5)


@pytest.mark.parametrize(
    ("size", "expected"), [(1, [1] * 10), (2, [2, 1, 1, 1, 1, 2, 1, 1]), (99, [3, 1, 1, 1, 2, 1, 1])]
)
def test_calls_end_where_something_is_due_and_change_no_file(tmp_path, size, expected):
    def validate(state):
        return {"loss": 100.0 + int(state.step)}

    run_loop(tmp_path / "single", START, counting(), config=loop(), measurements=[every(3, validate)])
    counts, config = [], loop(steps_per_call=size)
    update = counting(size=size, counts=counts)
    state = run_loop(tmp_path / "calls", START, update, config=config, measurements=[every(3, validate)])
    assert int(state.step) == sum(counts) == 10
    assert counts == expected
    for name in ("train.csv", "val.csv"):
        assert (tmp_path / "calls" / name).read_bytes() == (tmp_path / "single" / name).read_bytes()
    assert kept_steps(tmp_path / "calls") == kept_steps(tmp_path / "single")


def test_the_next_multiple_is_after_a_step():
    assert [next_multiple(step, 4, limit=10) for step in (0, 3, 4, 7, 8, 9)] == [4, 4, 8, 8, 10, 10]
    assert next_multiple(3, 0, limit=10) == 10


TABLE = "step,loss\n2,0.5\n4,0.25\n6,0.125\n"


@pytest.mark.parametrize(
    ("left", "first_step", "kept"),
    [
        (TABLE, 6, "step,loss\n2,0.5\n4,0.25\n6,0.125\n"),
        (TABLE, 4, "step,loss\n2,0.5\n4,0.25\n"),
        (TABLE, 5, "step,loss\n2,0.5\n4,0.25\n"),
        (TABLE, 0, "step,loss\n"),
        (TABLE + "8,0.06", 8, TABLE),
        (TABLE + "8", 8, TABLE),
        (TABLE[:-1], 6, "step,loss\n2,0.5\n4,0.25\n"),
        ("step,lo", 6, "step,loss\n"),
        ("", 6, "step,loss\n"),
        (None, 6, "step,loss\n"),
        (TABLE.encode().replace(b"0.25", b"0.2\xff") + b"\xfe\xff\n8\n", 8, TABLE.replace("4,0.25\n", "")),
    ],
)
def test_a_table_that_a_crash_left_is_mended(tmp_path, left, first_step, kept):
    if left is not None:
        (tmp_path / "train.csv").write_bytes(left if isinstance(left, bytes) else left.encode())
    with MetricLog(tmp_path, first_step=first_step) as log:
        log.write("train", 10, {"loss": 0.1}, title="training")
        log.write("train", 12, {"loss": 1 / 3}, title="training")
    expected = kept + f"10,0.1\n12,{1 / 3!r}\n"
    assert (tmp_path / "train.csv").read_bytes().decode() == expected
    assert {path.name for path in tmp_path.iterdir()} == {"train.csv", "tensorboard"}


def test_a_table_without_a_header_is_set_aside(tmp_path, caplog):
    damaged = TABLE.encode().replace(b"step", b"st\xffp")
    (tmp_path / "train.csv").write_bytes(damaged)
    with MetricLog(tmp_path, first_step=6) as log:
        log.write("train", 8, {"loss": 0.1}, title="training")
    assert (tmp_path / "train.csv").read_text() == "step,loss\n8,0.1\n"
    assert (tmp_path / "train.csv.damaged").read_bytes() == damaged
    assert "train.csv: its header is damaged; it is set aside as train.csv.damaged" in caplog.text


def test_a_table_of_an_earlier_version_keeps_its_columns(tmp_path):
    (tmp_path / "train.csv").write_text(TABLE)
    with MetricLog(tmp_path, first_step=6) as log:
        log.write("train", 8, {"loss": 0.1, "learning_rate": 0.5}, title="training")
    assert (tmp_path / "train.csv").read_text() == TABLE + "8,0.1\n"
