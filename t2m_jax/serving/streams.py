"""Bodies of requests and server-sent events, with limits, so that slow clients do not keep their places forever."""

from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

import anyio
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from t2m_jax.serving.jobs import Event
from t2m_jax.serving.schema import MAX_BODY, MAX_JSON

BODY_SECONDS = 20.0
"""Time in which the body of a request must come."""
MAX_BODIES = 8 * MAX_BODY
"""Bytes of all large bodies that are in memory at the same time."""
SEND_SECONDS = 20.0
"""Time in which a reader must take what was sent."""


class EventResponse(Response):
    """Server-sent events. A reader that disconnects, or is too slow (backpressure), ends them."""

    def __init__(self, events: AsyncIterator[Event | None]):
        """Takes the events; None is a time without one."""
        super().__init__(media_type="text/event-stream")
        # The length is not known yet; without one, the body is sent in chunks.
        del self.headers["content-length"]
        self.events = events

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Sends the events."""
        async with while_connected(receive):
            with anyio.CancelScope() as sending:
                sending.deadline = anyio.current_time() + SEND_SECONDS
                await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
                async for event in self.events:
                    sending.deadline = anyio.current_time() + SEND_SECONDS
                    # A line that begins with a colon is a comment: it only keeps the connection open.
                    text = ": waiting\n\n" if event is None else f"event: {event.name}\ndata: {event.data}\n\n"
                    await send({"type": "http.response.body", "body": text.encode(), "more_body": True})
                    sending.deadline = anyio.current_time() + SEND_SECONDS
                await send({"type": "http.response.body", "body": b"", "more_body": False})


@asynccontextmanager
async def while_connected(receive: Receive) -> AsyncIterator[None]:
    """Ends its block when the client closes the connection. The body of the request must have been read."""

    async def end_on_disconnect() -> None:
        while (await receive())["type"] != "http.disconnect":
            pass
        tasks.cancel_scope.cancel()

    async with anyio.create_task_group() as tasks:
        tasks.start_soon(end_on_disconnect)
        yield
        tasks.cancel_scope.cancel()


class Bodies:
    """The bodies of requests, with a limit for each and for those that are in memory at the same time."""

    def __init__(self) -> None:
        self.size = 0
        """Bytes of large bodies."""

    @asynccontextmanager
    async def read(self, request: Request, most: int = MAX_BODY) -> AsyncIterator[bytes]:
        """Gives the body of a request to the block, after which it is no longer in memory.

        Raises:
            HTTPException: It is too large, or too slow (slowloris), or there are too many.
        """
        parts = []
        size = 0
        counted = 0
        try:
            with _in_time():
                async for part in request.stream():
                    # Counted here, because `Content-Length` may be missing or wrong.
                    size += len(part)
                    if size > most:
                        raise HTTPException(413, f"the body has more than {most:,} bytes")
                    parts.append(part)
                    # Small bodies always have room, so that nobody's files stop the sentences of others.
                    if size > MAX_JSON:
                        self.size += size - counted
                        counted = size
                    if counted and self.size > MAX_BODIES:
                        raise HTTPException(
                            429, "too many files are being sent; try again in 5 s", {"Retry-After": "5"}
                        )
            body = b"".join(parts)
            parts.clear()
            yield body
        finally:
            self.size -= counted


@contextmanager
def _in_time() -> Iterator[None]:
    try:
        with anyio.fail_after(BODY_SECONDS):
            yield
    except TimeoutError:
        raise HTTPException(408, f"the body did not come in {BODY_SECONDS:g} s") from None


def is_json(request: Request) -> bool:
    """Returns whether a request says that its body is JSON."""
    return request.headers.get("content-type", "").partition(";")[0].strip() == "application/json"
