"""The queue, without a process: a test says what the process sends."""

import asyncio
import json
import threading

import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling.request import MotionRequest
from t2m_jax.serving import jobs as module
from t2m_jax.serving.jobs import Jobs, QueueFullError
from t2m_jax.serving.messages import NO_JOB, Cancel

PLAIN = MotionRequest(captions=("a person walks",))
TWO = MotionRequest(captions=("a person walks",), num_samples=2)
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
        self._process, self.sent = FakeProcess(), []
        self.say("ready", {"name": "none", "actions": ["walk", "wave"], "words": [], "taught": []})

    def _send(self, message):
        self.sent.append(message)

    def say(self, name, data, job=NO_JOB):
        self._on_message(job, name, json.dumps(data))

    def finish(self, task):
        self.say("done", {"seed": task.request.seed}, task.job)


def with_queue(test, **options):
    """Runs a test in an event loop, with a process that takes 6 motions at a time."""

    async def run():
        jobs = QueueOnly("none", **{"batch_size": 4, "max_waiting": 5} | options)
        await jobs.start()
        await test(jobs)
        jobs.stop()

    asyncio.run(run())


def names(job) -> list[str]:
    return [job.events.get_nowait().name for _ in range(job.events.qsize())]


def test_a_request_is_given_to_the_process_at_once():
    async def test(jobs):
        job = jobs.submit(PLAIN)
        (task,) = jobs.sent
        assert task == (job.number, PLAIN)
        jobs.finish(task)
        assert names(job) == ["queued", "done"] and not jobs.running

    with_queue(test)


def test_the_process_gets_as_much_as_it_can_use_in_the_order_of_the_queue():
    async def test(jobs):
        for request in (TWO, TWO, PLAIN, TWO, PLAIN):
            jobs.submit(request)
        assert [task.request for task in jobs.sent] == [TWO, TWO, PLAIN]  # the next pair has no room, and is the next
        jobs.finish(jobs.sent[0])
        assert [task.request for task in jobs.sent[3:]] == [TWO, PLAIN]

    with_queue(test)


def test_a_request_larger_than_all_room_is_made_alone():
    async def test(jobs):
        large = MotionRequest(captions=("a",), num_samples=8)
        jobs.submit(large)
        jobs.submit(PLAIN)
        assert [task.request for task in jobs.sent] == [large]
        jobs.finish(jobs.sent[0])
        assert len(jobs.sent) == 2

    with_queue(test)


def test_chains_do_not_wait_in_the_process_and_let_others_pass():
    async def test(jobs):
        for request in (CHAIN, CHAIN, CHAIN, PLAIN):
            jobs.submit(request)
        assert [task.request for task in jobs.sent] == [CHAIN, CHAIN, PLAIN]
        jobs.finish(jobs.sent[2])
        assert len(jobs.sent) == 3
        jobs.finish(jobs.sent[0])
        assert jobs.sent[3].request is CHAIN

    with_queue(test)


def test_a_process_that_does_not_read_stops_nobody():
    class Busy(QueueOnly):
        """Jobs whose process reads when the test says so."""

        _send, reads = Jobs._send, threading.Event()

        def _start_process(self):
            super()._start_process()
            self._connection = self

        def send(self, message):
            assert self.reads.wait(20)
            self.sent.append(message)

    async def test():
        jobs = Busy("none")
        await jobs.start()
        job = jobs.submit(PLAIN)
        assert jobs.sent == []
        jobs.reads.set()
        jobs._sender.shutdown()
        jobs.stop()
        assert [task.job for task in jobs.sent] == [job.number]

    asyncio.run(test())


def fill(jobs) -> list:
    """Returns jobs that fill the process."""
    return [jobs.submit(PLAIN) for _ in range(6)]


def test_a_full_queue_refuses_and_says_when_to_come_again():
    async def test(jobs):
        fill(jobs)
        for _ in range(5):
            jobs.submit(PLAIN)
        with pytest.raises(QueueFullError) as caught:
            jobs.submit(PLAIN)
        assert caught.value.retry_after >= 1 and len(jobs.waiting) == 5
        assert str(caught.value).startswith("5 requests are waiting")

    with_queue(test)


def test_positions_are_told_when_they_change():
    async def test(jobs):
        first, *_ = fill(jobs)
        others = [jobs.submit(PLAIN) for _ in range(2)]
        jobs.finish(jobs.sent[0])
        assert names(first)[-1] == "done"
        told = [json.loads(others[1].events.get_nowait().data)["position"] for _ in range(others[1].events.qsize())]
        assert told == [1, 0]

    with_queue(test)


def test_a_cancelled_request_is_forgotten():
    async def test(jobs):
        running, *_ = fill(jobs)
        waiting = jobs.submit(PLAIN)
        jobs.cancel(waiting)
        jobs.cancel(running)
        assert jobs.sent[-1] == Cancel(running.number) and not jobs.waiting
        last = jobs.submit(PLAIN)
        assert last in jobs.waiting
        jobs.say("codes", {}, running.number)
        jobs.say("dropped", {}, running.number)
        assert names(running) == ["queued"] and jobs.sent[-1].job == last.number

    with_queue(test)


def test_after_a_death_requests_are_tried_again(monkeypatch):
    monkeypatch.setattr(module, "RESTART_SECONDS", 0.0)

    async def test(jobs):
        job = jobs.submit(PLAIN)
        for alive in (True, True, False):
            assert len(jobs.running) == 1
            jobs._on_death()
            assert not jobs.is_alive
            await asyncio.sleep(0.05)
            assert len(jobs.sent) == alive
        assert names(job)[-1] == "failed" and jobs.is_alive
        assert b"t2m_worker_restarts_total 3.0" in jobs.measures.text()

    with_queue(test)


def test_a_file_that_may_have_ended_the_process_is_not_tried_again(monkeypatch):
    monkeypatch.setattr(module, "RESTART_SECONDS", 0.0)
    motion = Motion(np.zeros((4, 22, 3)), 20.0)
    vary = MotionRequest(captions=("a person walks",), start=motion, strength=0.5)

    async def test(jobs):
        guilty, waiting, plain = jobs.submit(vary), jobs.submit(vary), jobs.submit(PLAIN)
        for job in (guilty, plain):
            jobs.say("started", {}, job.number)
        jobs._on_death()
        assert names(guilty)[-1] == "failed"
        await asyncio.sleep(0.05)
        assert [task.job for task in jobs.sent] == [plain.number, waiting.number]

    with_queue(test)


def test_requests_keep_their_order_after_a_death(monkeypatch):
    monkeypatch.setattr(module, "RESTART_SECONDS", 0.0)

    async def test(jobs):
        numbers = [job.number for job in [*fill(jobs), jobs.submit(PLAIN)]]
        jobs._on_death()
        await asyncio.sleep(0.05)
        assert [task.job for task in jobs.sent] + [job.number for job in jobs.waiting] == numbers

    with_queue(test)


def test_a_request_that_takes_too_long_fails_and_the_process_is_killed(monkeypatch):
    monkeypatch.setattr(module, "WORK_SECONDS", 0.01)

    async def test(jobs):
        job, process = jobs.submit(PLAIN), jobs._process
        await asyncio.sleep(0.05)
        assert names(job)[-1] == "failed" and process.killed

    with_queue(test)


def test_the_time_of_compilation_does_not_count(monkeypatch):
    monkeypatch.setattr(module, "WORK_SECONDS", 0.2)
    monkeypatch.setattr(module, "COMPILE_SECONDS", 0.4)

    async def test(jobs):
        job, process = jobs.submit(CHAIN), jobs._process
        await asyncio.sleep(0.1)
        jobs.say("compiled", 0.1)  # before the request has begun
        await asyncio.sleep(0.15)
        assert not process.killed
        jobs.say("started", {}, job.number)
        await asyncio.sleep(0.1)
        for _ in range(9):  # it compiles forever
            jobs.say("compiled", 0.1)
        await asyncio.sleep(0.35)
        assert not process.killed and "failed" not in names(job)
        await asyncio.sleep(0.25)
        assert process.killed and names(job) == ["failed"]

    with_queue(test)


def test_what_takes_too_long_does_not_blame_a_small_request(monkeypatch):
    monkeypatch.setattr(module, "WORK_SECONDS", 0.01)

    async def test(jobs):
        job = jobs.submit(PLAIN)
        await asyncio.sleep(0.05)
        *_, failed = [json.loads(job.events.get_nowait().data) for _ in range(job.events.qsize())]
        assert failed["error"].startswith("no motion after 0 s of work; the server may be busy: try again later")

    with_queue(test)


def test_the_time_of_a_request_begins_when_the_one_before_it_ends(monkeypatch):
    monkeypatch.setattr(module, "WORK_SECONDS", 0.2)

    async def test(jobs):
        first, second, process = jobs.submit(CHAIN), jobs.submit(CHAIN), jobs._process
        await asyncio.sleep(0.1)
        jobs.say("started", {}, first.number)
        await asyncio.sleep(0.15)  # longer than the limit since the second one was sent
        jobs.finish(jobs.sent[0])
        jobs.say("started", {}, second.number)
        await asyncio.sleep(0.15)
        assert not process.killed and names(first)[-1] == "done" and "failed" not in names(second)
        await asyncio.sleep(0.1)
        assert process.killed and names(second)[-1] == "failed"

    with_queue(test)


def test_a_canceled_request_that_hangs_does_not_hold_the_others(monkeypatch):
    """The process cannot stop a chain in the middle, and motions of plain sentences go on beside it."""
    monkeypatch.setattr(module, "WORK_SECONDS", 0.2)

    async def test(jobs):
        first, second, process = jobs.submit(CHAIN), jobs.submit(CHAIN), jobs._process
        jobs.say("started", {}, first.number)
        jobs.cancel(second)
        await asyncio.sleep(0.1)
        jobs.finish(jobs.sent[0])
        jobs.say("started", {}, second.number)
        await asyncio.sleep(0.15)  # more than the limit since it was sent
        jobs.say("started", {}, jobs.submit(PLAIN).number)
        assert not process.killed
        await asyncio.sleep(0.1)
        assert process.killed

    with_queue(test)


def test_a_request_that_never_begins_does_not_wait_for_those_of_the_other_kind(monkeypatch):
    monkeypatch.setattr(module, "WORK_SECONDS", 0.1)

    async def test(jobs):
        chain, process = jobs.submit(CHAIN), jobs._process
        await asyncio.sleep(0.05)
        jobs.say("started", {}, jobs.submit(PLAIN).number)
        await asyncio.sleep(0.07)
        assert process.killed and names(chain)[-1] == "failed"

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
