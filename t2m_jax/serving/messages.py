"""What the server and the process that generates send each other; light, because the server does not need JAX."""

from typing import NamedTuple

from t2m_jax.serving.requests import MotionRequest

NO_JOB = -1
"""In place of a job's number, in messages about the process."""


class Task(NamedTuple):
    """A request that is worked on."""

    job: int
    request: MotionRequest
    seed: int


class Cancel(NamedTuple):
    """The motions of a request are not needed any more."""

    job: int
