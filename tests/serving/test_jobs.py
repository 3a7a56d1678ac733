"""The queue, without a process: a test says what the process sends."""

import asyncio
import json

import pytest

from t2m_jax.errors import UserError
from t2m_jax.serving import jobs as module
from t2m_jax.serving.jobs import Jobs, QueueFullError
from t2m_jax.serving.messages import NO_JOB
from t2m_jax.serving.requests import MotionRequest

PLAIN = MotionRequest(captions=("a person walks",))
TWO = MotionRequest(captions=("a person walks",), num_samples=2)
CAREFUL = MotionRequest(captions=("a person walks",), variety="low")
CHAIN = MotionRequest(captions=("a person walks", "a person waves"))


class FakeProcess:
    killed = False

    def kill(self):
        self.killed = True

    def terminate(self):
        pass

    def join(self, timeout=None):
        pass


class QueueOnly(Jobs):
    """Jobs whose process is the test."""

    def _start_process(self):
        self._process, self._connection, self.batches = FakeProcess(), self, []
        self.say("ready", {"slots": 1, "model": {"name": "none"}})

    def send(self, batch):
        self.batches.append(batch)

    def say(self, name, data, job=NO_JOB):
        self._on_message(job, name, json.dumps(data))

    def finish(self, batch):
        for task in batch.tasks:
            self.say("done", {"seed": task.seed}, task.job)
        self.say("finished", batch.number)


def with_queue(test, **options):
    """Runs a test in an event loop, with a queue for batches of 4 motions."""

    async def run():
        jobs = QueueOnly("none", **{"batch_size": 4, "max_waiting": 5} | options)
        await jobs.start()
        await test(jobs)
        jobs.stop()

    asyncio.run(run())


def names(job) -> list[str]:
    return [job.events.get_nowait().name for _ in range(job.events.qsize())]


def sizes(jobs) -> list[int]:
    return [len(batch.tasks) for batch in jobs.batches]


async def gathered():
    await asyncio.sleep(3 * module.GATHER_SECONDS)


def test_a_single_request_is_worked_on_at_once():
    async def test(jobs):
        job = jobs.submit(PLAIN)
        await gathered()
        (batch,) = jobs.batches
        assert batch.live and batch.tasks[0].request is PLAIN
        jobs.finish(batch)
        assert names(job) == ["queued", "done"] and not jobs.running

    with_queue(test)


def test_requests_share_a_batch_up_to_its_size():
    async def test(jobs):
        for request in (PLAIN, TWO, TWO, PLAIN, PLAIN):
            jobs.submit(request)
        assert [task.request for task in jobs.batches[0].tasks] == [PLAIN, TWO]  # the second pair has no room
        jobs.finish(jobs.batches[0])
        await gathered()
        assert [task.request for task in jobs.batches[1].tasks] == [TWO, PLAIN, PLAIN]

    with_queue(test)


def test_only_plain_requests_with_equal_options_share_a_batch():
    async def test(jobs):
        for request in (PLAIN, CAREFUL, CHAIN, CHAIN):
            jobs.submit(request)
        for _ in range(4):
            await gathered()
            jobs.finish(jobs.batches[-1])
        assert sizes(jobs) == [1, 1, 1, 1] and not jobs.waiting

    with_queue(test)


def test_a_full_queue_refuses_and_says_when_to_come_again():
    async def test(jobs):
        for _ in range(6):
            jobs.submit(CHAIN)
            await gathered()
        with pytest.raises(QueueFullError) as caught:
            jobs.submit(CHAIN)
        assert caught.value.retry_after >= 1 and len(jobs.waiting) == 5

    with_queue(test)


def test_positions_are_told_when_they_change():
    async def test(jobs):
        first = jobs.submit(CHAIN)
        await gathered()
        others = [jobs.submit(CHAIN) for _ in range(2)]
        jobs.finish(jobs.batches[0])
        await gathered()
        assert names(first)[-1] == "done"
        told = [json.loads(others[1].events.get_nowait().data)["position"] for _ in range(others[1].events.qsize())]
        assert told == [1, 0]

    with_queue(test)


def test_a_cancelled_request_is_forgotten():
    async def test(jobs):
        jobs.submit(CHAIN)
        await gathered()
        waiting, running = jobs.submit(PLAIN), next(iter(jobs.running.values()))
        jobs.cancel(waiting)
        jobs.cancel(running)
        jobs.finish(jobs.batches[0])
        await gathered()
        assert sizes(jobs) == [1] and names(running) == ["queued"]

    with_queue(test)


def test_after_a_death_requests_are_tried_once_more(monkeypatch):
    monkeypatch.setattr(module, "RESTART_SECONDS", 0.0)

    async def test(jobs):
        job = jobs.submit(PLAIN)
        await gathered()
        for alive in (True, False):
            assert len(jobs.running) == 1
            jobs._on_death()
            assert not jobs.is_alive
            await gathered()
            assert len(jobs.batches) == alive
        assert names(job)[-1] == "failed" and jobs.is_alive
        assert b"t2m_worker_restarts_total 2.0" in jobs.measures.text()

    with_queue(test)


def test_a_batch_that_takes_too_long_fails_and_the_process_is_killed(monkeypatch):
    monkeypatch.setattr(module, "BATCH_SECONDS", 0.01)

    async def test(jobs):
        job, process = jobs.submit(PLAIN), jobs._process
        await gathered()
        assert names(job)[-1] == "failed" and process.killed

    with_queue(test)


def test_a_model_that_cannot_be_loaded_is_an_error():
    class Refused(QueueOnly):
        def _start_process(self):
            self._process = FakeProcess()
            self.say("refused", "no such model")

    async def run():
        with pytest.raises(UserError, match="no such model"):
            await Refused("none").start()

    asyncio.run(run())


def test_a_seed_is_drawn_if_none_is_given():
    async def test(jobs):
        seeds = {jobs.submit(PLAIN).seed for _ in range(3)} | {jobs.submit(MotionRequest(captions=("a",), seed=5)).seed}
        assert len(seeds) == 4 and 5 in seeds

    with_queue(test)
