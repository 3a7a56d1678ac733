"""Runs the server until it is asked to end."""

import asyncio
import contextlib
import gc
import os
import socket
from collections.abc import Callable, Iterator

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from t2m_jax.errors import UserError
from t2m_jax.sampling.request import MotionRequest
from t2m_jax.serving.app import LOOPBACK, make_app
from t2m_jax.serving.jobs import Jobs

MAX_CONNECTIONS = 512
"""Further ones are answered with 503."""
CLOSE_SECONDS = 5
"""Time for answers that are being sent when the server ends."""
IDLE_SECONDS = 20.0
"""A connection without a whole request is closed after this time, or after twice of it if it had requests before."""


def serve(
    model_name: str,
    *,
    host: str,
    port: int,
    token: str | None,
    batch_size: int,
    max_waiting: int,
    on_ready: Callable[[str], None],
) -> None:
    """Serves until the process gets SIGINT or SIGTERM.

    Args:
        model_name: See `t2m_jax.load`.
        host: Address to listen on.
        port: 0 chooses a free one.
        token: What requests must bring; None if everybody may ask.
        batch_size: Motions that are generated together.
        max_waiting: Requests that may wait.
        on_ready: Called with the address of the page.

    Raises:
        UserError: The model cannot be loaded, or the address cannot be used.
    """
    # NumPy's products are small here, and its threads would wait for each other by spinning. All processes inherit it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    listener = _bind(host, port)
    jobs = Jobs(model_name, batch_size=batch_size, max_waiting=max_waiting)
    asyncio.run(_serve(jobs, listener, token, on_ready))


async def _serve(jobs: Jobs, listener: socket.socket, token: str | None, on_ready: Callable[[str], None]) -> None:
    try:
        await jobs.start()
        app = make_app(jobs, token=token, hosts=("*",) if token else LOOPBACK)
        config = uvicorn.Config(
            app,
            http=HttpProtocol,
            lifespan="off",
            log_level="warning",
            server_header=False,
            limit_concurrency=MAX_CONNECTIONS,
            timeout_graceful_shutdown=CLOSE_SECONDS,
        )
        host, port = listener.getsockname()[:2]
        # The first sentence loads a dictionary. A search for garbage among all that was loaded would stop the event
        # loop for a quarter of a second.
        MotionRequest(captions=("walk, then wave",)).in_turn(jobs.knowledge)
        gc.collect()
        gc.freeze()
        with _telling(host, port):  # another server may have begun to listen meanwhile
            listener.listen()
        on_ready(f"http://{f'[{host}]' if ':' in host else host}:{port}/")
        await uvicorn.Server(config).serve(sockets=[listener])
    finally:
        jobs.stop()


class HttpProtocol(H11Protocol):
    """HTTP without connections that wait forever: they would take the places of others."""

    _last_cycle: object = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begins to watch the connection."""
        super().connection_made(transport)
        self._watch()

    def _watch(self) -> None:
        self.loop.call_later(IDLE_SECONDS, self._close_if_idle)

    def _close_if_idle(self) -> None:
        """Closes the connection if there was no new request since the last time, and none is worked on."""
        is_idle = getattr(self.cycle, "response_complete", True)  # before the first request, there is no cycle
        if is_idle and self.cycle is self._last_cycle:
            self.transport.close()
        elif not self.transport.is_closing():
            self._last_cycle = self.cycle if is_idle else self
            self._watch()


def _bind(host: str, port: int) -> socket.socket:
    """Returns a socket with an address, so that a used port is told before the model is loaded.

    It does not listen yet: clients would wait for an answer until the model is there, and now they are refused.
    """
    with _telling(host, port):
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        # With the protocol, asyncio knows that this is TCP, and turns off Nagle's algorithm: every answer after the
        # first of a connection would wait for 40 ms.
        listener = socket.socket(family, kind, protocol)
        if os.name == "posix":  # on Windows, it would take a port that another program listens on
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
    listener.setblocking(False)
    return listener


@contextlib.contextmanager
def _telling(host: str, port: int) -> Iterator[None]:
    """Raises `UserError` if a block cannot use an address."""
    try:
        yield
    except OSError as error:
        raise UserError(f"--host, --port: cannot listen on {host}:{port} ({error.strerror or error})") from None
