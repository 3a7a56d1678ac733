"""The queue of requests, and the process that works on it."""

import asyncio
import contextlib
import dataclasses
import itertools
import json
import math
import multiprocessing
import secrets
import threading
from collections import deque
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, NamedTuple

from t2m_jax.errors import UserError
from t2m_jax.serving.measures import Measures
from t2m_jax.serving.messages import NO_JOB, Batch, Task
from t2m_jax.serving.requests import MotionRequest

BATCH_SIZE = 16
"""Motions that are generated together. Two batches are worked on at a time."""
MAX_WAITING = 64
"""Requests that wait; further ones are refused."""
BATCH_SECONDS = 120.0
"""Longest time for a batch. After it, the process is replaced, and its requests fail."""
GATHER_SECONDS = 0.02
"""Time that the process waits for a batch to fill: the users of the last one have just got their motions."""
RESTART_SECONDS = 1.0
"""Time before a process that has died is replaced."""
END_SECONDS = 5.0
"""Time for the process to end by itself."""
MAX_TRIES = 2
"""How often a request is given to a process that then dies. It may be the reason."""
FINAL_EVENTS = ("done", "failed")


class Event(NamedTuple):
    """Something that a user is told about a request."""

    name: str
    data: str
    """JSON."""


class QueueFullError(Exception):
    """Too many requests are waiting."""

    def __init__(self, retry_after: int):
        """Takes the seconds after which there is probably a place."""
        super().__init__(f"{MAX_WAITING} requests are waiting; try again in {retry_after} s")
        self.retry_after = retry_after


@dataclasses.dataclass(eq=False)
class Job:
    """A request with its events."""

    number: int
    request: MotionRequest
    seed: int
    tries: int = 0
    events: "asyncio.Queue[Event]" = dataclasses.field(default_factory=asyncio.Queue)

    def tell(self, name: str, data: Any) -> None:
        """Adds an event."""
        self.events.put_nowait(Event(name, json.dumps(data)))

    @property
    def group(self) -> tuple[Any, ...]:
        """Requests with the same group can be generated together; a request that is not plain has its own."""
        request = self.request
        return (request.variety, request.guidance_scale) if request.is_plain else (self.number,)


class _Running(NamedTuple):
    """A batch that the process works on."""

    num_motions: int
    started: float
    timer: asyncio.TimerHandle


def _work(*args: Any) -> None:
    """Runs in the process that generates. Only it imports JAX."""
    from t2m_jax.serving.worker import work

    work(*args)


class Jobs:
    """The queue, and the process, which is replaced when it dies."""

    def __init__(self, model_name: str, *, batch_size: int = BATCH_SIZE, max_waiting: int = MAX_WAITING):
        """Takes what `worker.work` needs, and the length of the queue; `start` starts the process."""
        self.model_name, self.batch_size, self.max_waiting = model_name, batch_size, max_waiting
        self.model: dict[str, Any] = {}
        """What the process says of the model, once it is ready."""
        self.waiting: deque[Job] = deque()
        self.running: dict[int, Job] = {}
        self.measures = Measures(waiting=lambda: len(self.waiting), running=lambda: len(self.running))
        self._numbers = itertools.count()
        self._process: SpawnProcess | None = None
        self.is_alive = False
        """Whether the process can generate."""
        self._batches: dict[int, _Running] = {}
        self._free_slots = 0
        self._seconds_per_motion = 0.1

    async def start(self) -> None:
        """Starts the process, and waits until it is ready.

        Raises:
            UserError: The model cannot be loaded.
        """
        self._loop, self._ready = asyncio.get_running_loop(), asyncio.get_running_loop().create_future()
        self._start_process()
        await self._ready

    def stop(self) -> None:
        """Ends the process."""
        process, self._process = self._process, None
        if process is not None:
            process.terminate()
            process.join(END_SECONDS)
            process.kill()
            process.join()

    def submit(self, request: MotionRequest) -> Job:
        """Returns the job of a new request.

        Raises:
            QueueFullError: Too many requests are waiting.
        """
        if len(self.waiting) >= self.max_waiting:
            motions = sum(job.request.num_samples for job in self.waiting)
            raise QueueFullError(max(1, math.ceil(motions * self._seconds_per_motion)))
        seed = secrets.randbelow(2**32) if request.seed is None else request.seed
        job = Job(next(self._numbers), request, seed)
        self.waiting.append(job)
        self._tell_positions()
        self._dispatch_soon()
        return job

    def cancel(self, job: Job) -> None:
        """Forgets a job. What is already being generated is not interrupted, because others share its batch."""
        if job in self.waiting:
            self.waiting.remove(job)
            self._tell_positions()
        self.running.pop(job.number, None)

    def _tell_positions(self) -> None:
        for position, job in enumerate(self.waiting):
            job.tell("queued", {"position": position, "seed": job.seed})

    def _start_process(self) -> None:
        context = multiprocessing.get_context("spawn")
        ours, its = context.Pipe()
        process = context.Process(target=_work, args=(its, self.model_name, self.batch_size), daemon=True)
        process.start()
        its.close()
        self._process, self._connection = process, ours
        threading.Thread(target=self._read, args=(ours,), daemon=True).start()

    def _read(self, connection: Connection) -> None:
        """Passes what a process sends to the event loop, until the process ends; runs in a thread of its own."""
        try:
            while True:
                self._loop.call_soon_threadsafe(self._on_message, *connection.recv())
        except (EOFError, OSError):
            self._loop.call_soon_threadsafe(self._on_death)
        except RuntimeError:  # the event loop was closed
            return

    def _on_message(self, number: int, name: str, data: str) -> None:
        if number == NO_JOB:
            self._on_state(name, json.loads(data))
        elif number in self.running:
            self.running[number].events.put_nowait(Event(name, data))
            if name in FINAL_EVENTS:
                del self.running[number]

    def _on_state(self, name: str, data: Any) -> None:
        """Notes that the process is ready, has finished a batch, or cannot load the model."""
        if name == "refused" and not self._ready.done():
            self._ready.set_exception(UserError(data))
        elif name == "ready":
            self.is_alive, self.model, self._free_slots = True, data["model"], data["slots"]
            if not self._ready.done():
                self._ready.set_result(None)
        elif name == "finished":
            batch = self._batches.pop(data)
            batch.timer.cancel()
            seconds = self._loop.time() - batch.started
            self.measures.batch_seconds.observe(seconds)
            self._seconds_per_motion = 0.8 * self._seconds_per_motion + 0.2 * seconds / batch.num_motions
            self._free_slots += 1
        self._dispatch_soon()

    def _on_death(self) -> None:
        """Replaces the process. Its requests come first, unless they had their chances."""
        self.is_alive, self._free_slots = False, 0
        for batch in self._batches.values():
            batch.timer.cancel()
        self._batches.clear()
        if self._process is None:  # `stop` ended it
            return
        if not self._ready.done():
            self._ready.set_exception(UserError(f"{self.model_name}: the process that loads it has died"))
            return
        self.measures.restarts.inc()
        for job in reversed(self.running.values()):
            if job.tries >= MAX_TRIES:
                job.tell("failed", {"error": "the process that generates has died twice; try again", "seed": job.seed})
            else:
                self.waiting.appendleft(job)
        self.running.clear()
        self._loop.call_later(RESTART_SECONDS, self._start_process)

    def _on_timeout(self, jobs: list[Job]) -> None:
        for job in jobs:
            if self.running.pop(job.number, None) is not None:
                error = f"it took longer than {BATCH_SECONDS:g} s; ask for less"
                job.tell("failed", {"error": error, "seed": job.seed})
        if self._process is not None:
            self._process.kill()

    def _dispatch_soon(self) -> None:
        """Gives the process a batch: at once if it is full, or a little later."""
        if sum(job.request.num_samples for job in self.waiting) >= self.batch_size:
            self._dispatch()
        elif self.waiting and self._free_slots:
            self._loop.call_later(GATHER_SECONDS, self._dispatch)

    def _dispatch(self) -> None:
        if not self._free_slots or not self.waiting:
            return
        chosen = self._next_jobs()
        for job in chosen:
            job.tries += 1
            self.running[job.number] = job
        number, motions = next(self._numbers), sum(job.request.num_samples for job in chosen)
        timer = self._loop.call_later(BATCH_SECONDS, self._on_timeout, chosen)
        self._batches[number] = _Running(motions, self._loop.time(), timer)
        self._free_slots -= 1
        tasks = tuple(Task(job.number, job.request, job.seed) for job in chosen)
        with contextlib.suppress(OSError):  # it has just died; `_on_death` follows
            self._connection.send(Batch(number, tasks, live=not self.waiting))
        self._tell_positions()
        self._dispatch_soon()

    def _next_jobs(self) -> list[Job]:
        """Removes and returns the first waiting job, and those that can be generated with it."""
        chosen: list[Job] = []
        room, group = self.batch_size, self.waiting[0].group
        for job in list(self.waiting):
            if job.group == group and job.request.num_samples <= room:
                chosen.append(job)
                room -= job.request.num_samples
                self.waiting.remove(job)
        return chosen
