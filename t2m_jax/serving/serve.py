"""Runs the server until it is asked to end."""

import asyncio
import socket
from collections.abc import Callable

import uvicorn

from t2m_jax.errors import UserError
from t2m_jax.serving.app import LOOPBACK, make_app
from t2m_jax.serving.jobs import Jobs

MAX_CONNECTIONS = 512
"""Further ones are answered with 503."""
CLOSE_SECONDS = 5
"""Time for answers that are being sent when the server ends."""


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
    listener = _listen(host, port)
    jobs = Jobs(model_name, batch_size=batch_size, max_waiting=max_waiting)
    asyncio.run(_serve(jobs, listener, token, on_ready))


async def _serve(jobs: Jobs, listener: socket.socket, token: str | None, on_ready: Callable[[str], None]) -> None:
    try:
        await jobs.start()
        app = make_app(jobs, token=token, hosts=("*",) if token else LOOPBACK)
        config = uvicorn.Config(
            app,
            lifespan="off",
            log_level="warning",
            server_header=False,
            limit_concurrency=MAX_CONNECTIONS,
            timeout_graceful_shutdown=CLOSE_SECONDS,
        )
        host, port = listener.getsockname()[:2]
        on_ready(f"http://{f'[{host}]' if ':' in host else host}:{port}/")
        await uvicorn.Server(config).serve(sockets=[listener])
    finally:
        jobs.stop()


def _listen(host: str, port: int) -> socket.socket:
    """Returns a socket that listens, so that a used port is told before the model is loaded."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen()
    except OSError as error:
        raise UserError(f"--host, --port: cannot listen on {host}:{port} ({error.strerror or error})") from None
    listener.setblocking(False)
    return listener
