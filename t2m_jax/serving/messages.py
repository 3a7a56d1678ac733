"""What the queue and the process that generates send each other."""

from typing import NamedTuple

from t2m_jax.sampling.request import MotionRequest

NO_JOB = -1
"""In place of a job's number, in messages about the process."""


class Task(NamedTuple):
    """From the queue to the process that generates: a request to work on."""

    job: int
    request: MotionRequest

    @property
    def is_plain(self) -> bool:
        """Whether it is for one sentence and nothing else, so that it shares a batch with those of other users."""
        return len(self.request.captions) == 1 and self.request.seconds is None and self.request.start is None


class Cancel(NamedTuple):
    """From the queue to the process that generates: nobody needs the motions of a request any more."""

    job: int
