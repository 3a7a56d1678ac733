"""A real server with a tiny model, and a client that reads its answers."""

import http.client
import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from typing import NamedTuple

import pytest

import tests
from t2m_jax.checkpoints.bundle import save_bundle
from tests.tiny import HIFIGPT_BUNDLE, random_bundle

START_SECONDS = 120


@pytest.fixture(scope="session", autouse=True)
def main_module():
    """Gives the main program a file, which processes of pytest-xdist lack: AnyIO's processes run it before files."""
    with pytest.MonkeyPatch.context() as patch:
        if getattr(sys.modules["__main__"], "__file__", None) is None:
            patch.setattr(sys.modules["__main__"], "__file__", tests.__file__, raising=False)
        yield


class Answer(NamedTuple):
    status: int
    headers: dict
    body: bytes

    @property
    def json(self):
        return json.loads(self.body)

    @property
    def events(self) -> list:
        """The server-sent events as pairs of a name and data."""
        blocks = [block for block in self.body.decode().split("\n\n") if block and not block.startswith(":")]
        lines = [block.split("\n") for block in blocks]
        return [(name.removeprefix("event: "), json.loads(data.removeprefix("data: "))) for name, data in lines]


class Client:
    """Asks a server."""

    def __init__(self, port: int, pid: int):
        self.port, self.pid = port, pid

    def open(self, method: str, path: str, body=None, headers=None) -> http.client.HTTPConnection:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=START_SECONDS)
        given = {"Content-Type": "application/json"} if isinstance(body, dict) else {}
        data = json.dumps(body).encode() if isinstance(body, dict) else body
        connection.request(method, path, data, given | (headers or {}))
        return connection

    def ask(self, method: str, path: str, body=None, headers=None) -> Answer:
        connection = self.open(method, path, body, headers)
        response = connection.getresponse()
        answer = Answer(
            response.status, {name.lower(): value for name, value in response.getheaders()}, response.read()
        )
        connection.close()
        return answer

    def motions(self, *captions: str, **fields) -> dict:
        """Returns the data of the last event of a request for motions."""
        answer = self.ask("POST", "/motions", {"captions": list(captions), **fields})
        assert answer.status == 200, answer.body
        name, data = answer.events[-1]
        assert name == "done", data
        return data


@contextmanager
def running_server(*arguments: str, **environment: str):
    """Starts `t2m serve` on a free port."""
    command = [sys.executable, "-m", "t2m_jax", "serve", "--port", "0", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | environment)
    try:
        address = process.stdout.readline()
        assert address.startswith("http://"), address
        yield Client(int(address.strip().strip("/").rpartition(":")[2]), process.pid)
    finally:
        process.terminate()
        assert process.wait(timeout=30) in (0, -15, 143)
        process.stdout.close()


@pytest.fixture(scope="session")
def model_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("serving") / "tiny"
    save_bundle(folder, random_bundle(HIFIGPT_BUNDLE), card="# tiny\n")
    return folder


@pytest.fixture(scope="module")
def server(model_folder):
    with running_server("--model", str(model_folder), "--batch", "4", "--queue", "6") as client:
        yield client


@pytest.fixture(scope="session")
def address():
    """The studio with the demo model, for all tests in a browser: to start it takes longer than most of them."""
    with running_server("--batch", "4") as client:
        yield f"http://127.0.0.1:{client.port}/"


def wait_until(condition, seconds: float = 60) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)
