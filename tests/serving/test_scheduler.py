"""What the scheduler does with options before it samples."""

import jax
import pytest

from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling.request import MotionRequest, SamplingOptions
from t2m_jax.serving import scheduler as module
from t2m_jax.serving.messages import Task
from t2m_jax.serving.scheduler import Scheduler
from t2m_jax.serving.worker import watch_compilation
from tests.tiny import random_bundle


@pytest.fixture
def sent():
    return []


@pytest.fixture
def scheduler(sent):
    return Scheduler(TextToMotion(random_bundle()), 2, lambda *event: sent.append(event))


def task(**options) -> Task:
    return Task(0, MotionRequest(captions=("a person walks",), seed=3, options=SamplingOptions(**options)))


def test_options_that_do_not_fit_the_model_fail_alone(scheduler, sent):
    scheduler.add(task(stop_rule="argmax"))
    ((job, name, data),) = sent
    assert (job, name, data["seed"]) == (0, "failed", 3) and data["error"].startswith("stop-rule: ")
    assert not scheduler.is_busy


def test_few_programs_are_kept(scheduler, monkeypatch):
    cleared = []
    monkeypatch.setattr(module.jax, "clear_caches", lambda: cleared.append(len(scheduler.programs)))
    monkeypatch.setattr(module, "MAX_PROGRAMS", 3)
    for temperature in (1.0, 0.9, 0.8, 1.0, 0.7):
        scheduler.add(task(temperature=temperature))
        scheduler.add(task(temperature=temperature, raw=True, guidance_scale=2.0))  # the same program
    assert cleared == [3] and len(scheduler.programs) == 1


def test_an_exception_that_nobody_foresaw_fails_one_request(scheduler, sent, monkeypatch, capsys):
    def fail(*_):
        raise OverflowError("int too large")

    chain = Task(1, MotionRequest(captions=("a person walks", "a person waves")))
    monkeypatch.setattr(scheduler.model, "make", fail)
    scheduler.add(chain)
    scheduler.embed = fail
    scheduler.add(task())
    assert [(job, name) for job, name, _ in sent if name == "failed"] == [(1, "failed"), (0, "failed")]
    assert "log" in sent[-1][2]["error"] and "OverflowError" in capsys.readouterr().err
    assert not scheduler.is_busy


def test_it_is_told_how_long_a_program_was_compiled():
    told = []
    watch_compilation(told.append)
    double = jax.jit(lambda x: 2 * x)
    double(1.0)
    assert told and all(0 < seconds < 60 for seconds in told)
    count = len(told)
    double(2.0)  # is compiled
    assert len(told) == count
