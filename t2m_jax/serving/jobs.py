"""The queue of requests, and the process that works on it."""

import asyncio
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

BATCH_SIZE = 32
"""Motions that are generated together."""
MAX_WAITING = 64
"""Requests that wait; further ones are refused."""
BATCH_SECONDS = 120.0
"""Longest time for a batch. After it, the process is replaced, and its requests fail."""
GATHER_SECONDS = 0.02
"""Time that the process waits for a batch to fill: the users of the last one have just got their motions."""
RESTART_SECONDS = 1.0
"""Time before a process that has died is replaced."""
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
        self._idle = False
        self._seconds_per_motion = 0.1
        self._timer: asyncio.TimerHandle | None = None
        self._started = 0.0

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
        """Notes that the process is ready, idle, or cannot load the model."""
        if name == "refused":
            if not self._ready.done():
                self._ready.set_exception(UserError(data))
            return
        if name == "ready":
            self.model, self.is_alive = data, True
            if not self._ready.done():
                self._ready.set_result(None)
        if name == "idle" and self._timer is not None:
            self._timer.cancel()
            seconds = self._loop.time() - self._started
            self.measures.batch_seconds.observe(seconds)
            self._seconds_per_motion = 0.8 * self._seconds_per_motion + 0.2 * seconds / self._motions
        self._idle = True
        self._dispatch_soon()

    def _on_death(self) -> None:
        """Replaces the process. Its requests come first, unless they had their chances."""
        if self._process is None:  # `stop` ended it
            return
        self.is_alive = self._idle = False
        if self._timer is not None:
            self._timer.cancel()
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

    def _on_timeout(self) -> None:
        for job in self.running.values():
            job.tell("failed", {"error": f"it took longer than {BATCH_SECONDS:g} s; ask for less", "seed": job.seed})
        self.running.clear()
        if self._process is not None:
            self._process.kill()

    def _dispatch_soon(self) -> None:
        """Gives the process a batch: at once if it is full, or a little later."""
        if not self._idle or not self.waiting:
            return
        if sum(job.request.num_samples for job in self.waiting) >= self.batch_size:
            self._dispatch()
        else:
            self._loop.call_later(GATHER_SECONDS, self._dispatch)

    def _dispatch(self) -> None:
        if not self._idle or not self.waiting:
            return
        self._idle = False
        chosen = self._next_jobs()
        for job in chosen:
            job.tries += 1
        self.running = {job.number: job for job in chosen}
        self._motions = sum(job.request.num_samples for job in chosen)
        self._started = self._loop.time()
        self._timer = self._loop.call_later(BATCH_SECONDS, self._on_timeout)
        tasks = tuple(Task(job.number, job.request, job.seed) for job in chosen)
        try:
            self._connection.send(Batch(tasks, live=not self.waiting))
        except OSError:  # it has just died; `_on_death` follows
            return
        self._tell_positions()

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
