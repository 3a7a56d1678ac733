"""The queue of requests, and the process that works on it."""

import asyncio
import contextlib
import dataclasses
import itertools
import json
import math
import multiprocessing
import threading
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, NamedTuple

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

from t2m_jax.errors import UserError
from t2m_jax.sampling.request import MotionRequest
from t2m_jax.serving.messages import NO_JOB, Cancel, Task
from t2m_jax.serving.priority import lower_priority
from t2m_jax.text.coverage import Knowledge

BATCH_SIZE = 32
"""Motions that are generated together."""
AHEAD = 1.5
"""Motions that the process knows of, as a multiple of those that it generates, so that it never waits for the next."""
MAX_EDITS = 2
"""Requests that are not plain and that the process knows of. It works on one at a time."""
MAX_WAITING = 64
"""Requests that wait; further ones are refused."""
WORK_SECONDS = 120.0
"""Longest time for a request without the queue and without the compilation of programs, which the first request of a
kind needs. After it, the request fails, and the process is replaced."""
TRY_AGAIN = "the server may be busy: try again later; if it is not, ask for fewer or shorter motions"
COMPILE_SECONDS = 480.0
"""Most time for the compilation of programs beyond that."""
RESTART_SECONDS = 0.2
"""Time before a process that has died is replaced."""
END_SECONDS = 5.0
"""Time for the process to end by itself."""
MAX_TRIES = 3
"""How often a request is given to a process that then dies."""
FINAL_EVENTS = ("done", "failed")
HISTOGRAM_SECONDS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0)


class Measures:
    """Counters and histograms of a server, in Prometheus's text format."""

    def __init__(self, *, waiting: Callable[[], int], running: Callable[[], int]):
        """Takes functions that count requests in the queue, and those that are worked on."""
        registry = self._registry = CollectorRegistry()
        shared: Any = {"registry": registry}
        self.answers = Counter("t2m_answers", "Requests for motions by how they ended", ["result"], **shared)
        self.motions = Counter("t2m_motions", "Motions that were sent", **shared)
        self.restarts = Counter("t2m_worker_restarts", "Processes that died and were replaced", **shared)
        shared["buckets"] = HISTOGRAM_SECONDS
        self.seconds = Histogram("t2m_request_seconds", "From a request to its motions", **shared)
        self.work_seconds = Histogram("t2m_work_seconds", "Time without the queue", **shared)
        for name, count in (("waiting", waiting), ("running", running)):
            Gauge(f"t2m_{name}_requests", f"Requests that are {name}", registry=registry).set_function(count)

    def text(self) -> bytes:
        """Returns all values."""
        return generate_latest(self._registry)


class Event(NamedTuple):
    """Something that a user is told about a request."""

    name: str
    data: str
    """JSON."""


class QueueFullError(Exception):
    """Too many requests are waiting."""

    def __init__(self, num_waiting: int, retry_after: int):
        """Takes how many wait, and the seconds after which there is probably a place."""
        super().__init__(f"{num_waiting} requests are waiting; try again in {retry_after} s")
        self.retry_after = retry_after


@dataclasses.dataclass(eq=False)
class Job:
    """A request in the queue with its events."""

    number: int
    request: MotionRequest
    tries: int = 0
    start: float = 0.0
    """When the process began to work on it, or got it."""
    end: float = 0.0
    """When it fails if it is not ready."""
    is_started: bool = False
    """Whether the process has begun to work on it."""
    timer: asyncio.TimerHandle | None = None
    events: "asyncio.Queue[Event]" = dataclasses.field(default_factory=asyncio.Queue)

    def tell(self, name: str, data: Mapping[str, Any]) -> None:
        """Adds an event, with the seed."""
        self.events.put_nowait(Event(name, json.dumps({**data, "seed": self.request.seed})))

    @property
    def is_suspect(self) -> bool:
        """Whether it may have ended the process that worked on it: other requests have nothing but sentences."""
        return self.is_started and self.request.start is not None

    def stop_timer(self) -> None:
        """Ends the limit of the time of work."""
        if self.timer is not None:
            self.timer.cancel()


def _work(*args: Any) -> None:
    """Runs in the process that generates. Only it imports JAX."""
    lower_priority()  # before JAX starts its threads
    from t2m_jax.serving.worker import work

    work(*args)


def _write(connection: Connection, message: Task | Cancel) -> None:
    with contextlib.suppress(OSError):  # the process has just died; `_on_death` follows
        connection.send(message)


class Jobs:
    """The queue, and the process, which is replaced when it dies."""

    def __init__(self, model_name: str, *, batch_size: int = BATCH_SIZE, max_waiting: int = MAX_WAITING):
        """Takes what `worker.work` needs, and the length of the queue; `start` starts the process."""
        self.model_name = model_name
        self.batch_size = batch_size
        self.max_waiting = max_waiting
        self.model: dict[str, Any] = {}
        """What the process says of the model, once it is ready."""
        self.waiting: deque[Job] = deque()
        self.running: dict[int, Job] = {}
        self.measures = Measures(waiting=lambda: len(self.waiting), running=lambda: len(self.running))
        self._numbers = itertools.count()
        self._process: SpawnProcess | None = None
        self._sender = ThreadPoolExecutor(1)
        self.is_alive = False
        """Whether the process can generate."""
        self._sent: dict[int, Job] = {}
        """What the process knows of, also what nobody waits for any more."""
        self._last_end = 0.0
        self._seconds_per_motion = 0.1

    async def start(self) -> None:
        """Starts the process, and waits until it is ready.

        Raises:
            UserError: The model cannot be loaded.
        """
        self._loop = asyncio.get_running_loop()
        self._ready = self._loop.create_future()
        self._start_process()
        await self._ready

    @property
    def knowledge(self) -> Knowledge:
        """The words and actions that the model knows."""
        words, taught = (frozenset(self.model[name]) for name in ("words", "taught"))
        return Knowledge(words, tuple(self.model["actions"]), taught=taught)

    def stop(self) -> None:
        """Ends the process."""
        process = self._process
        self._process = None
        if process is not None:
            process.terminate()
            process.join(END_SECONDS)
            process.kill()  # for one that is in a long call of XLA, which no signal interrupts
            process.join()

    def submit(self, request: MotionRequest) -> Job:
        """Returns the job of a new request, whose sentences are those in turn (see `MotionRequest.in_turn`).

        Raises:
            QueueFullError: Too many requests are waiting.
        """
        if len(self.waiting) >= self.max_waiting:
            motions = sum(job.request.num_samples for job in self.waiting)
            raise QueueFullError(len(self.waiting), max(1, math.ceil(motions * self._seconds_per_motion)))
        job = Job(next(self._numbers), request)
        self.waiting.append(job)
        self._tell_positions()
        self._dispatch()
        return job

    def cancel(self, job: Job) -> None:
        """Forgets a job."""
        if job in self.waiting:
            self.waiting.remove(job)
            self._tell_positions()
        if self.running.pop(job.number, None) is not None:
            self._send(Cancel(job.number))

    def _tell_positions(self) -> None:
        for position, job in enumerate(self.waiting):
            job.tell("queued", {"position": position})

    def _start_process(self) -> None:
        # Not by fork: threads of this process may hold locks, and JAX does not work in a forked process.
        context = multiprocessing.get_context("spawn")
        ours, its = context.Pipe()
        process = context.Process(target=_work, args=(its, self.model_name, self.batch_size), daemon=True)
        process.start()
        its.close()  # otherwise, the end of the process would not end the connection
        self._process = process
        self._connection = ours
        threading.Thread(target=self._read, args=(ours,), daemon=True).start()

    def _read(self, connection: Connection) -> None:
        """Passes what a process sends to the event loop, until the process ends; runs in a thread of its own."""
        with contextlib.suppress(RuntimeError):  # the event loop was closed
            try:
                while True:
                    self._loop.call_soon_threadsafe(self._on_message, *connection.recv())
            except (EOFError, OSError):
                self._loop.call_soon_threadsafe(self._on_death)

    def _on_message(self, number: int, name: str, data: str) -> None:
        if number == NO_JOB:
            self._on_state(name, json.loads(data))
            return
        # Also if it was canceled: the process ends what is not plain, and may not come back from it.
        job = self._sent[number]
        if not job.is_started:
            job.is_started = True
            self._start_timer(job)  # anew: it may have waited for another request
        if number in self.running:
            job.events.put_nowait(Event(name, data))
        if name in (*FINAL_EVENTS, "dropped"):
            self.running.pop(number, None)
            self._forget(number)
            self._dispatch()

    def _forget(self, number: int) -> None:
        """Notes that the process has finished a request."""
        job = self._sent.pop(number)
        now = self._loop.time()
        job.stop_timer()
        self.measures.work_seconds.observe(now - job.start)
        seconds = (now - max(self._last_end, job.start)) / job.request.num_samples
        # A moving average, so that `Retry-After` follows the load.
        self._seconds_per_motion = 0.9 * self._seconds_per_motion + 0.1 * seconds
        self._last_end = now

    def _on_state(self, name: str, data: Any) -> None:
        """Notes that the process is ready, or cannot load the model."""
        if name == "refused" and not self._ready.done():
            self._ready.set_exception(UserError(data))
        elif name == "ready":
            self.is_alive = True
            self.model = data
            if not self._ready.done():
                self._ready.set_result(None)
            self._dispatch()
        elif name == "compiled":
            for job in self._sent.values():
                self._set_timer(job, min(job.end + data, job.start + WORK_SECONDS + COMPILE_SECONDS))

    def _on_death(self) -> None:
        """Replaces the process. Its requests come first, unless they had their chances."""
        self.is_alive = False
        for job in self._sent.values():
            job.stop_timer()
        self._sent.clear()
        if self._process is None:  # `stop` ended it
            return
        if not self._ready.done():
            self._ready.set_exception(UserError(f"{self.model_name}: the process that loads it has died"))
            return
        self.measures.restarts.inc()
        # Backwards, because each goes to the front of the queue.
        for job in reversed(self.running.values()):
            if job.is_suspect or job.tries >= MAX_TRIES:
                job.tell("failed", {"error": "the process that generates has died while it worked on this; try again"})
            else:
                self.waiting.appendleft(job)
        self.running.clear()
        self._loop.call_later(RESTART_SECONDS, self._start_process)

    def _start_timer(self, job: Job) -> None:
        job.start = self._loop.time()
        self._set_timer(job, job.start + WORK_SECONDS)

    def _set_timer(self, job: Job, end: float) -> None:
        job.stop_timer()
        job.end = end
        job.timer = self._loop.call_at(end, self._on_timeout, job)

    def _on_timeout(self, job: Job) -> None:
        is_plain = job.request.is_plain
        ahead = (other for other in self._sent.values() if other.request.is_plain == is_plain)
        if not job.is_started and any(other.is_started for other in ahead):
            self._start_timer(job)  # it waits for that one, which has a limit of its own
            return
        if self.running.pop(job.number, None) is not None:
            seconds = f"{self._loop.time() - job.start:.0f}"
            job.tell("failed", {"error": f"no motion after {seconds} s of work; {TRY_AGAIN}"})
        if self._process is not None:
            self._process.kill()

    def _dispatch(self) -> None:
        """Gives the process the next requests, as many as it should know of."""
        num_before = len(self.waiting)
        while self.is_alive and (job := self._next_job()) is not None:
            self.waiting.remove(job)
            job.tries += 1
            self.running[job.number] = job
            self._sent[job.number] = job
            self._start_timer(job)
            self._send(Task(job.number, job.request))
        if len(self.waiting) < num_before:
            self._tell_positions()

    def _next_job(self) -> Job | None:
        """Returns what the process should get next, if it has room. Plain jobs and others pass each other."""
        sent = [job.request for job in self._sent.values()]
        known = sum(request.num_samples for request in sent if request.is_plain)
        num_edits = sum(not request.is_plain for request in sent)
        plain = next((job for job in self.waiting if job.request.is_plain), None)
        # A request with more motions than there is room for at all is made alone.
        if plain is not None and (known == 0 or known + plain.request.num_samples <= AHEAD * self.batch_size):
            return plain
        edit = next((job for job in self.waiting if not job.request.is_plain), None)
        return edit if num_edits < MAX_EDITS else None

    def _send(self, message: Task | Cancel) -> None:
        # In a thread, because a process that compiles does not read, and a motion is longer than a pipe.
        self._sender.submit(_write, self._connection, message)
