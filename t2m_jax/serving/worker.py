"""The process that generates motions: it gets requests, and sends events of them as JSON texts."""

import contextlib
import json
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, get_args

import jax

from t2m_jax.errors import UserError
from t2m_jax.motion.formats import format_options, motion_formats
from t2m_jax.motion.reaching import exact_joints
from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling.request import SamplingOptions, StopRuleName
from t2m_jax.serving.answers import ModelData
from t2m_jax.serving.messages import NO_JOB, Cancel
from t2m_jax.serving.scheduler import Scheduler
from t2m_jax.text.coverage import PromptWarning

COMPILATION = "/jax/core/compile/"
"""Begins what JAX calls the times in which it traces a program, and XLA compiles it."""


def work(connection: Connection, model_name: str, num_slots: int) -> None:
    """Generates until the connection is closed.

    Args:
        connection: Gets each `Task` and `Cancel`. Sends (job, event, JSON text): `ready` once, and the events of jobs.
        model_name: See `t2m_jax.load`.
        num_slots: Motions that are generated together, whatever the number of requests is, so that a motion does not
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

    watch_compilation(lambda seconds: send(NO_JOB, "compiled", seconds))
    try:
        scheduler = Scheduler(TextToMotion.load(model_name), num_slots, send)
        scheduler.warm_up()
    except UserError as error:
        send(NO_JOB, "refused", str(error))
        return
    send(NO_JOB, "ready", describe_model(scheduler.model, model_name))
    with scheduler.threads(), contextlib.suppress(EOFError):  # the server has ended
        while True:
            while connection.poll(0 if scheduler.is_busy else None):
                message = connection.recv()
                scheduler.cancel(message.job) if isinstance(message, Cancel) else scheduler.add(message)
            scheduler.step()


def watch_compilation(tell: Callable[[float], None]) -> None:
    """Tells of each step in the compilation of a program how many seconds it took."""

    def listen(event: str, duration_secs: float, **_: Any) -> None:
        if event.startswith(COMPILATION):
            tell(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)


def describe_model(model: TextToMotion, name: str) -> ModelData:
    """Returns what the page says of a model."""
    downsample = model.config.tokenizer.downsample
    return {
        "name": name,
        "about": repr(model),
        "license": model.license,
        "fps": model.skeleton.fps,
        "downsample": downsample,
        "longest_seconds": model.config.generator.max_codes * downsample / model.skeleton.fps,
        "joints": list(model.skeleton.joint_names),
        "exact_joints": exact_joints(model.skeleton),
        "guidance_scale": model.parts.guidance_scale(),
        "stop_rules": _stop_rules(model),
        "actions": list(model.knowledge.actions),
        "words": sorted(model.knowledge.words),
        "taught": sorted(model.knowledge.taught),
        "examples": list(model.examples),
        "file_options": {name: format_options(f"motion.{name}") for name in motion_formats()},
    }


def _stop_rules(model: TextToMotion) -> list[str]:
    """Returns the names of the stop rules that a request may ask for."""
    found = []
    for name in get_args(StopRuleName):
        with contextlib.suppress(UserError):
            model.parts.sampling(SamplingOptions(stop_rule=name))
            found.append(name)
    return found
