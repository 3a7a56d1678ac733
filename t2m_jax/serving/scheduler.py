"""Continuous batching: the motions of all requests share the slots of one batch, and begin and end at any time."""

import contextlib
import dataclasses
import functools
import itertools
import os
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Int

from t2m_jax.errors import UserError
from t2m_jax.export.html import scene_record
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling.decode import GrowingMotion
from t2m_jax.sampling.programs import SLOT_ROWS
from t2m_jax.sampling.prompts import Sample, read_prompts
from t2m_jax.sampling.request import MotionRequest, SamplingOptions
from t2m_jax.sampling.slots import Progress, Slots
from t2m_jax.serving.files import motion_record
from t2m_jax.serving.messages import NO_JOB, Task
from t2m_jax.serving.wording import in_browser

EXAMPLE_PROMPT = "a person walks forward"
DECODED_TOGETHER = 4
"""Motions that are decoded together. The batch is always full, so that a motion does not depend on the others."""
MAX_LIVE = 4
"""Most motions at a time whose frames are sent before they are whole; it takes time."""
AVERAGED_MOTIONS = 10
"""Motions whose mean length says how much of a motion is done; where it ends, the model decides."""
MOST_SHARE = 0.95
"""Largest share that is told of a motion that is not whole."""
CACHED_TEXTS = 1024
"""Sentences whose embeddings are kept."""
MAX_PROGRAMS = 32
"""Sets of sampling options whose compiled programs are kept: users may ask for more than fit into the memory."""
Codes = Int[np.ndarray, "N R"]
Send = Callable[[int, str, Any], None]
"""From a job, the name of an event and its data."""


class TaskSample(NamedTuple):
    """From the queue to a slot of the batch: one motion of a task."""

    task: Task
    sample: Sample


class Scheduler:
    """Makes the motions of tasks, and sends their events. Plain tasks share the slots of one batch."""

    def __init__(self, model: TextToMotion, num_slots: int, send: Send):
        """Takes the model, the number of slots, and what sends an event."""
        self.model = model
        self.num_slots = num_slots
        self.send = send
        self.waiting: deque[TaskSample] = deque()
        self.active: dict[int, TaskSample] = {}
        """The motions in the slots."""
        self.growing: dict[int, GrowingMotion] = {}
        """What is sent of the motions in the slots before they are whole."""
        self.ended: dict[int, dict[int, Codes]] = {}
        """Codes of the motions of jobs that have further motions, by their numbers."""
        self.num_rows: dict[int, int] = {}
        """Rows that were sent of jobs whose motions are not whole."""
        self.usual_rows = float(model.config.generator.max_codes)
        """Mean number of rows of the last motions."""
        self.slots: Slots | None = None
        self.group: SamplingOptions | None = None
        """The options of all motions in the slots."""
        self.programs: set[SamplingOptions] = set()
        self.embed = functools.lru_cache(CACHED_TEXTS)(lambda text: model.text_encoder([text])[0])
        self.finishing: Executor | None = None
        self.editing: Executor | None = None

    @contextlib.contextmanager
    def threads(self) -> Iterator[None]:
        """Works on what needs no slots in other threads."""
        if jax.local_device_count() > 1:  # programs on several devices could wait for each other forever
            yield
            return
        with ThreadPoolExecutor(1) as self.finishing, ThreadPoolExecutor(1) as self.editing:
            yield

    def warm_up(self) -> None:
        """Compiles what most requests need."""
        nothing = Scheduler(self.model, self.num_slots, lambda *_: None)
        nothing.add(Task(NO_JOB, MotionRequest(captions=(EXAMPLE_PROMPT,))))
        sample = nothing.waiting[0].sample
        while nothing.is_busy:
            nothing.step()
        parts = self.model.config
        longest = np.zeros((parts.generator.max_codes, parts.tokenizer.num_quantizers), np.int32)
        for codes, clean in itertools.product((longest[:1], longest), (True, False)):
            nothing._decode([(sample, codes)], clean=clean)
        nothing._grow().add(longest, ended=True)

    @property
    def is_busy(self) -> bool:
        """Whether `step` has something to do."""
        return bool(self.waiting or self.active)

    def add(self, task: Task) -> None:
        """Begins a task, or lets it wait."""
        self._limit_programs(task.request.options)
        if not task.request.is_plain:
            _call(self.editing, self._edit, task)
            return
        with self._failing(task):
            self.model.parts.sampling(task.request.options)  # refuses what does not fit the model
            (prompt,) = read_prompts(task.request.captions, self.model.knowledge, self.model.text_encoder)
            self.embed(prompt.read)  # here, because an error would concern one request only
            for number in range(task.request.num_samples):
                self.waiting.append(TaskSample(task, Sample(prompt, task.request.seed, number)))

    def cancel(self, job: int) -> None:
        """Forgets a plain task if it has not ended."""
        slots = [slot for slot, one in self.active.items() if one.task.job == job]
        waiting = [one for one in self.waiting if one.task.job != job]
        if not slots and len(waiting) == len(self.waiting):
            return
        self.waiting = deque(waiting)
        self.ended.pop(job, None)
        self.num_rows.pop(job, None)
        for slot in slots:
            del self.active[slot]
        if self.slots is not None:
            self.slots.release(slots)
        self.send(job, "dropped", {})

    def step(self) -> None:
        """Samples some rows of all motions in slots, and sends what is new."""
        self._begin()
        if self.slots is None or not self.active:
            return
        live = self.slots.sampling.stop_rule.ends_early and len(self.active) <= MAX_LIVE
        whole = []
        for progress in self.slots.step():
            one = self.active[progress.slot]
            self._send_rows(one, progress, live=live and not progress.ended)
            if progress.ended:
                del self.active[progress.slot]
                found = self.ended.setdefault(one.task.job, {})
                found[one.sample.number] = progress.codes
                self.usual_rows += (len(progress.codes) - self.usual_rows) / AVERAGED_MOTIONS
                if len(found) == one.task.request.num_samples:
                    self.num_rows.pop(one.task.job, None)
                    whole.append((one, self.ended.pop(one.task.job)))
        if whole:
            _call(self.finishing, self._finish_plain, whole)

    def _begin(self) -> None:
        """Puts waiting motions into free slots."""
        if self.waiting and not self.active:
            # Options are compiled into the program of the slots, so all motions of a batch have the same.
            self.group = options = self.waiting[0].task.request.options
            sampling = self.model.parts.sampling(options)
            self.slots = self.model.parts.slots(self.num_slots, sampling, guidance_scale=options.guidance_scale)
        if self.slots is None:
            return
        begun: dict[int, Sample] = {}
        for slot in self.slots.free:
            if not self.waiting or self.waiting[0].task.request.options != self.group:
                break
            self.active[slot] = one = self.waiting.popleft()
            self.growing[slot] = self._grow()
            begun[slot] = one.sample
            if one.sample.number == 0:
                self.send(one.task.job, "started", {"seed": one.task.request.seed})
        if begun:
            texts = [self.embed(sample.prompt.read) for sample in begun.values()]
            self.slots.begin(list(begun), texts, [sample.key for sample in begun.values()])

    def _grow(self) -> GrowingMotion:
        longest = self.model.config.generator.max_codes
        return GrowingMotion(self.model.tokenizer, skeleton=self.model.skeleton, step=SLOT_ROWS, max_codes=longest)

    def _limit_programs(self, options: SamplingOptions) -> None:
        """Forgets all compiled programs if there are too many; those that are still needed come back from the disk."""
        program = dataclasses.replace(options, raw=False, whole=False, guidance_scale=None)  # not compiled in
        if program not in self.programs and len(self.programs) == MAX_PROGRAMS:
            jax.clear_caches()
            self.programs.clear()
        self.programs.add(program)

    def _send_rows(self, one: TaskSample, progress: Progress, *, live: bool) -> None:
        """Sends new codes and, if `live`, the frames that they make final."""
        if not progress.num_new:
            return
        growing = self.growing[progress.slot]
        # While others wait, frames are not decoded; all of them come with the next rows that are.
        motion = growing.add(progress.codes[growing.num_rows :]) if live else None
        caption = one.sample.prompt.text
        scene = None if motion is None else scene_record([dataclasses.replace(motion, caption=caption)])
        new = progress.codes[-progress.num_new :].tolist()
        share = self._share_after(one.task, len(new))
        self.send(one.task.job, "codes", {"sample": one.sample.number, "codes": new, "scene": scene, "share": share})

    def _share_after(self, task: Task, num_new: int) -> float:
        """Returns the probable share of a plain task that is done after some more rows of codes."""
        self.num_rows[task.job] = self.num_rows.get(task.job, 0) + num_new
        return min(self.num_rows[task.job] / (self.usual_rows * task.request.num_samples), MOST_SHARE)

    def _decode(self, rows: Sequence[tuple[Sample, Codes]], *, clean: bool) -> list[Motion]:
        """Returns the motions of codes, decoded in full batches. Short motions have batches of their own."""
        longest = self.model.config.generator.max_codes
        motions: dict[int, Motion] = {}
        limits = (0, -(-longest // 2), longest)
        for shorter, limit in itertools.pairwise(limits):  # two shapes only: each is a program
            places = [place for place, (_, codes) in enumerate(rows) if shorter < len(codes) <= limit]
            for first in range(0, len(places), DECODED_TOGETHER):
                chosen = places[first : first + DECODED_TOGETHER]
                samples, codes = zip(*(rows[place] for place in chosen), strict=True)
                found = self.model.parts.decode_samples(samples, codes, size=limit, batch=DECODED_TOGETHER, clean=clean)
                motions |= zip(chosen, found, strict=True)
        return [motions[place] for place in range(len(rows))]

    def _finish_plain(self, whole: Sequence[tuple[TaskSample, Mapping[int, Codes]]]) -> None:
        """Sends the motions of plain tasks with the same options, each with its last motion."""
        rows = [
            (last.sample._replace(number=number), codes)
            for last, found in whole
            for number, codes in sorted(found.items())
        ]
        made: list[tuple[Task, list[Motion]]] = []
        with self._failing(*(last.task for last, _ in whole)):
            motions = iter(self._decode(rows, clean=not whole[0][0].task.request.options.raw))
            made = [(last.task, list(itertools.islice(motions, len(found)))) for last, found in whole]
        for task, its in made:
            with self._failing(task):
                self._finish(task, its)

    def _edit(self, task: Task) -> None:
        """Makes the motions of a task that is not plain."""
        self.send(task.job, "started", {"seed": task.request.seed})
        with self._failing(task):

            def tell(ready: float | int, total: int) -> None:
                self.send(task.job, "progress", {"share": ready / total})

            self._finish(task, list(self.model.make(task.request, on_progress=tell)))

    def _finish(self, task: Task, motions: Sequence[Motion]) -> None:
        """Sends the motions of a request."""
        for warning in dict.fromkeys(motion.warning for motion in motions if motion.warning):
            self.send(task.job, "warning", {"message": warning})
        records = [motion_record(motion, task.request.targets) for motion in motions]
        self.send(task.job, "done", {"seed": task.request.seed, "scene": scene_record(motions), "motions": records})

    @contextlib.contextmanager
    def _failing(self, *tasks: Task) -> Iterator[None]:
        """Fails some tasks if the block raises an exception, so that others do not notice it."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 - also a bug, or too little memory, which must not end the process
            if not isinstance(error, UserError):
                traceback.print_exc()
            told = (
                in_browser(error)
                if isinstance(error, UserError)
                else "the motion cannot be made; the server's log says why"
            )
            for task in tasks:
                self.send(task.job, "failed", {"error": told, "seed": task.request.seed})


def _call(executor: Executor | None, function: Callable[..., None], *args: Any) -> None:
    """Calls a function, in a thread if there is one for it."""

    def guarded() -> None:
        try:
            function(*args)
        except BaseException:  # noqa: BLE001 - a bug, or too little memory: the server replaces the process, as after a crash
            traceback.print_exc()
            os._exit(1)

    if executor is None:
        function(*args)
    else:
        executor.submit(guarded)
