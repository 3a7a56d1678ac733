"""The process that generates motions: it gets requests, and sends events of them as JSON texts."""

import contextlib
import json
import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from typing import Any

import jax

from t2m_jax.errors import UserError
from t2m_jax.export import scene_record
from t2m_jax.motion.record import Motion
from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling.batches import CONCURRENT_BATCHES
from t2m_jax.sampling.prompts import read_prompts
from t2m_jax.sampling.strategies import Strategy, make_strategy
from t2m_jax.sampling.together import NewRows, Sample, generate_together
from t2m_jax.serving.messages import NO_JOB, Batch, Task
from t2m_jax.serving.records import motion_from_data, motion_record
from t2m_jax.serving.requests import TEMPERATURES, MotionRequest, decode_base64
from t2m_jax.text.coverage import PromptWarning

EXAMPLE_PROMPT = "a person walks forward"
Send = Callable[[int, str, Any], None]
"""From a job, the name of an event and its data."""


def work(connection: Connection, model_name: str, batch_size: int) -> None:
    """Generates until the connection is closed.

    Args:
        connection: Gets `Batch`es. Sends (job, event, JSON text): `ready` once, and `finished` after each batch.
        model_name: See `t2m_jax.load`.
        batch_size: Motions that are generated together, whatever the number of requests is, so that a motion does not
            depend on it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which then ends this process
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    # Here, because filters of warnings belong to the process, not to a thread. Motions have their warnings, too.
    warnings.simplefilter("ignore", PromptWarning)
    lock = threading.Lock()

    def send(job: int, event: str, data: Any) -> None:
        text = json.dumps(data, separators=(",", ":"))
        with lock:
            connection.send((job, event, text))

    try:
        maker = Maker(TextToMotion.load(model_name), batch_size, send)
        maker.warm_up()
    except UserError as error:
        send(NO_JOB, "refused", str(error))
        return
    # On several devices, each batch is divided among all of them. They could wait for each other forever.
    slots = CONCURRENT_BATCHES if jax.local_device_count() == 1 else 1
    send(NO_JOB, "ready", {"slots": slots, "model": describe_model(maker.model, model_name)})

    def make(batch: Batch) -> None:
        try:
            maker.make(batch)
            send(NO_JOB, "finished", batch.number)
        except BaseException:  # noqa: BLE001 - a bug, or too little memory: the server replaces the process, as after a crash
            traceback.print_exc()
            os._exit(1)

    with ThreadPoolExecutor(slots) as threads, contextlib.suppress(EOFError):  # the server has ended
        while True:
            threads.submit(make, connection.recv())


class Maker:
    """Makes the motions of batches, and sends their events."""

    def __init__(self, model: TextToMotion, batch_size: int, send: Send):
        """Takes the model, the fixed size of batches, and what sends an event."""
        self.model, self.batch_size, self.send = model, batch_size, send

    def warm_up(self) -> None:
        """Compiles what most requests need."""
        request = MotionRequest(captions=(EXAMPLE_PROMPT,))
        nothing = Maker(self.model, self.batch_size, lambda *_: None)
        nothing.make(Batch(NO_JOB, (Task(NO_JOB, request, 0),), live=True))

    def make(self, batch: Batch) -> None:
        """Sends the events of each request, the last of which is `done` or `failed`."""
        try:
            for task in batch.tasks:
                self.send(task.job, "started", {"seed": task.seed})
            if batch.tasks[0].request.is_plain:
                self._make_plain(batch)
            else:
                self._finish(batch.tasks[0], self._edited(batch.tasks[0]))
        except UserError as error:
            for task in batch.tasks:
                self.send(task.job, "failed", {"error": str(error), "seed": task.seed})

    def _make_plain(self, batch: Batch) -> None:
        """Makes one sentence per request, all in one batch of the fixed size."""
        request = batch.tasks[0].request
        samples, owners = [], []
        for task in batch.tasks:
            (prompt,) = read_prompts(task.request.captions, self.model.knowledge, self.model.text_encoder)
            samples += [Sample(prompt, task.seed, number) for number in range(task.request.num_samples)]
            owners += [(task, number) for number in range(task.request.num_samples)]

        def report(rows: NewRows) -> None:
            task, number = owners[rows.sample]
            scene = None if rows.motion is None else scene_record([rows.motion])
            self.send(task.job, "codes", {"sample": number, "codes": rows.codes.tolist(), "scene": scene})

        motions = generate_together(
            self.model,
            samples,
            batch_size=self.batch_size,
            sampling=self.model.sampling(_strategy(request)),
            guidance_scale=request.guidance_scale,
            on_rows=report,
            decode_early=batch.live,
        )
        for task in batch.tasks:
            own = [motion for motion, (owner, _) in zip(motions, owners, strict=True) if owner is task]
            self._finish(task, own)

    def _edited(self, task: Task) -> list[Motion]:
        """Returns the motions of a request that is not plain."""
        request, given = task.request, _given_motion(task.request)
        options: Any = {"seed": task.seed, "num_samples": request.num_samples}
        options |= {"strategy": _strategy(request), "guidance_scale": request.guidance_scale}
        if given is not None and request.span is not None:
            return self.model.redo(given, request.span, request.captions[0], **options)
        if given is not None and request.edit == "vary":
            return self.model.vary(given, request.strength, request.captions[0], **options)
        return self.model.generate_chain(request.captions, start=given, seconds=request.seconds, **options)

    def _finish(self, task: Task, motions: Sequence[Motion]) -> None:
        """Sends the motions of a request."""
        for warning in dict.fromkeys(motion.warning for motion in motions if motion.warning):
            self.send(task.job, "warning", {"message": warning})
        records = [motion_record(motion) for motion in motions]
        self.send(task.job, "done", {"seed": task.seed, "scene": scene_record(motions), "motions": records})


def _strategy(request: MotionRequest) -> Strategy:
    return make_strategy(TEMPERATURES[request.variety], None)


def _given_motion(request: MotionRequest) -> Motion | None:
    if request.motion is None:
        return None
    return motion_from_data(decode_base64(request.motion), request.motion_format)


def describe_model(model: TextToMotion, name: str) -> dict[str, Any]:
    """Returns what the page says of a model."""
    downsample = model.config.tokenizer.downsample
    return {
        "name": name,
        "about": repr(model),
        "license": model.license,
        "fps": model.skeleton.fps,
        "downsample": downsample,
        "longest_seconds": model.config.generator.max_codes * downsample / model.skeleton.fps,
        "guidance_scale": model.guidance_scale(),
        "actions": list(model.knowledge.actions),
        "words": sorted(model.knowledge.words),
    }
