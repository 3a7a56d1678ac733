"""What `t2m serve` refuses before it loads a model, in one line and with exit code 2."""

import asyncio
import socket
import sys

import pytest

from t2m_jax.cli.main import main
from t2m_jax.cli.serve import TOKEN_VARIABLE
from t2m_jax.errors import UserError
from t2m_jax.serving import serve
from tests.serving.test_jobs import QueueOnly


def error_of(capsys, *arguments: str) -> str:
    """Returns the error of a command."""
    assert main(["serve", *arguments]) == 2
    *_, line = capsys.readouterr().err.splitlines()
    assert line.startswith("t2m: error: ")
    return line


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["--host", "0.0.0.0"], "--host: 0.0.0.0 can be reached by others; set a token"),
        (["--port", "70000"], "--port: 70000 is not a number from 0 to 65535"),
        (["--port", "x"], "--port"),
        (["--batch", "0"], "--batch: 0 is not a whole number from 1 to 1024"),
        (["--queue", "-1"], "--queue: -1 is not a whole number from 1 to 10000"),
        (["--host", "no.such.host.invalid", "--token", "secret"], "cannot listen on no.such.host.invalid:8000"),
        (["--model", "no/such/model", "--port", "0"], "no/such/model"),
    ],
)
def test_wrong_options(capsys, monkeypatch, arguments, part):
    monkeypatch.delenv(TOKEN_VARIABLE, raising=False)
    assert part in error_of(capsys, *arguments)


def test_the_token_of_the_environment_is_asked_for(monkeypatch):
    given = {}
    monkeypatch.setattr(serve, "serve", lambda model, **options: given.update(options))
    monkeypatch.setenv(TOKEN_VARIABLE, "secret")
    assert main(["serve", "--host", "0.0.0.0"]) == 0 and given["token"] == "secret"
    assert main(["serve", "--token", "other"]) == 0 and given["token"] == "other"
    # No token would fit an empty one.
    monkeypatch.setenv(TOKEN_VARIABLE, "")
    assert main(["serve"]) == 0 and given["token"] is None


def test_a_port_that_is_used(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"cannot listen on 127.0.0.1:{port}" in error_of(capsys, "--port", f"{port}")


class Loading(QueueOnly):
    """Jobs for which a test does something while their model loads."""

    def __init__(self, meanwhile):
        super().__init__("none")
        self.meanwhile = meanwhile

    async def start(self):
        self.meanwhile()
        await super().start()


class ReadyError(Exception):
    """The server has said that it is ready."""


def serve_with(meanwhile, on_ready) -> None:
    """Serves on a free port; both functions get the port."""
    listener = serve._bind("127.0.0.1", 0)
    port = listener.getsockname()[1]

    def ready(_):
        on_ready(port)
        raise ReadyError

    with listener:
        asyncio.run(serve._serve(Loading(lambda: meanwhile(port)), listener, None, ready))


def test_clients_are_refused_until_the_model_is_loaded():
    """A connection that nobody answers would let health checks wait."""

    def is_refused(port):
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port))

    with pytest.raises(ReadyError):
        serve_with(is_refused, lambda port: socket.create_connection(("127.0.0.1", port)).close())


@pytest.mark.skipif(sys.platform != "linux", reason="other systems let no second program have the port at all")
def test_a_port_that_is_taken_while_the_model_loads():
    with socket.socket() as other:

        def take(port):
            other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            other.bind(("127.0.0.1", port))
            other.listen()

        with pytest.raises(UserError, match=r"^--host, --port: cannot listen on 127\.0\.0\.1:\d+ \("):
            serve_with(take, lambda _: None)


def test_a_missing_extra(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert "t2m serve: needs uvicorn; pip install 't2m-jax[serve]'" in error_of(capsys)
