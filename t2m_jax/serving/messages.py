"""What the queue and the process that generates send each other."""

from typing import NamedTuple

from t2m_jax.sampling.request import MotionRequest

NO_JOB = -1
"""In place of a job's number, in messages about the process."""


class Task(NamedTuple):
    """From the queue to the process that generates: a request to work on."""

    job: int
    request: MotionRequest


class Cancel(NamedTuple):
    """From the queue to the process that generates: nobody needs the motions of a request any more."""

    job: int
