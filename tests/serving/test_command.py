"""What `t2m serve` refuses before it loads a model, in one line and with exit code 2."""

import socket
import sys

import pytest

from t2m_jax.cli.main import main
from t2m_jax.cli.serve import TOKEN_VARIABLE
from t2m_jax.serving import serve


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


def test_a_missing_extra(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert "t2m serve: needs uvicorn; pip install 't2m-jax[serve]'" in error_of(capsys)
