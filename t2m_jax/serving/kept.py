"""Answers that go on when their reader leaves, so that a page finds its motion again after a reload."""

import asyncio
import contextlib
import re
from collections.abc import AsyncGenerator, AsyncIterator

from starlette.exceptions import HTTPException

from t2m_jax.serving.jobs import Event

KEEP_SECONDS = 600.0
"""Time for which a finished answer waits for its reader."""
MAX_KEPT = 128 * 2**20
"""Bytes of finished answers; beyond it, the oldest ones are forgotten."""
KEY = re.compile(r"[\w-]{16,64}", re.ASCII)
"""What a key looks like. Whoever knows it may read the answer, so pages choose random ones."""


class _Answer:
    """The events of a request up to now, read by a task of its own."""

    def __init__(self, events: AsyncGenerator[Event | None, None]):
        self.events: list[Event | None] = []
        self.is_ended = False
        self._news = asyncio.Event()
        self.task = asyncio.create_task(self._collect(events))

    @property
    def size(self) -> int:
        """Characters of all events."""
        return sum(len(event.data) for event in self.events if event is not None)

    async def _collect(self, events: AsyncGenerator[Event | None, None]) -> None:
        try:
            # Closed also if the task is canceled, which cancels the job.
            async with contextlib.aclosing(events):
                async for event in events:
                    self.events.append(event)
                    self._tell()
        finally:
            self.is_ended = True
            self._tell()

    def _tell(self) -> None:
        """Wakes all who wait for the next event."""
        self._news.set()
        self._news = asyncio.Event()

    async def follow(self) -> AsyncIterator[Event | None]:
        """Yields all events from the first one."""
        place = 0
        while True:
            news = self._news
            for event in self.events[place:]:
                place += 1
                yield event
            if self.is_ended and place == len(self.events):
                return
            if place == len(self.events):
                await news.wait()


class KeptAnswers:
    """All answers that go on without a reader, by their keys."""

    def __init__(self) -> None:
        self._answers: dict[str, _Answer] = {}

    def check(self, key: str) -> None:
        """Raises `HTTPException` if a key cannot be used for a new answer."""
        if not KEY.fullmatch(key):
            raise HTTPException(400, "keep: a key has 16 to 64 letters, digits, - and _; choose a random one")
        if key in self._answers:
            raise HTTPException(409, "keep: there is already a request with this key; choose another one")

    def start(self, key: str, events: AsyncGenerator[Event | None, None]) -> AsyncIterator[Event | None]:
        """Returns the events of a new answer, which goes on if nobody reads them."""
        answer = self._answers[key] = _Answer(events)
        answer.task.add_done_callback(lambda _: self._on_end(key, answer))
        return answer.follow()

    def follow(self, key: str) -> AsyncIterator[Event | None]:
        """Returns the events of an answer from the first one.

        Raises:
            HTTPException: There is no such answer, or no longer.
        """
        if key not in self._answers:
            raise HTTPException(404, "the server no longer has this motion; ask for it again")
        return self._answers[key].follow()

    def forget(self, key: str) -> None:
        """Ends an answer; a request that is not ready is canceled."""
        answer = self._answers.pop(key, None)
        if answer is not None:
            answer.task.cancel()

    def _forget_answer(self, key: str, answer: _Answer) -> None:
        """Ends this answer, but not a newer one with its key."""
        if self._answers.get(key) is answer:
            self.forget(key)

    def _on_end(self, key: str, answer: _Answer) -> None:
        """Limits the time and the memory of answers that nobody may ever read."""
        if answer.task.cancelled():
            return
        asyncio.get_running_loop().call_later(KEEP_SECONDS, self._forget_answer, key, answer)
        ended = {key: answer.size for key, answer in self._answers.items() if answer.is_ended}
        while sum(ended.values()) > MAX_KEPT and len(ended) > 1:
            oldest = next(iter(ended))
            del ended[oldest]
            self.forget(oldest)
