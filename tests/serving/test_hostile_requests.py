"""Requests that are made to disturb others, sent over sockets to a server without a model."""

import asyncio
import base64
import json
import socket
import threading
import time
from typing import NamedTuple

import numpy as np
import pytest
import uvicorn

from t2m_jax.serving import serve as module
from t2m_jax.serving.app import make_app
from t2m_jax.serving.files import MAX_FRAMES
from t2m_jax.serving.schema import MAX_BODY, MAX_CHARACTER_BODY, MAX_JSON
from t2m_jax.serving.streams import MAX_BODIES, Bodies
from tests.motion.hostile_files import HOSTILE_FILES, npz_with
from tests.serving.conftest import Client, wait_until
from tests.serving.test_jobs import QueueOnly

JSON = {"Content-Type": "application/json"}
TOKEN = "secret"


class Served(NamedTuple):
    client: Client
    server: uvicorn.Server
    jobs: QueueOnly
    delays: list
    """Seconds of work of the event loop between two chances of others."""


@pytest.fixture(scope="module")
def served():
    """A server in a thread, whose queue never gives anything away."""
    config = uvicorn.Config(None, http=module.HttpProtocol, log_config=None, lifespan="off", port=0)
    server, jobs, delays = uvicorn.Server(config), QueueOnly("none"), []

    async def watch():
        while True:
            start = time.thread_time()  # not of the clock, because the machine may be busy with other things
            await asyncio.sleep(0.01)
            delays.append(time.thread_time() - start)

    async def run():
        await jobs.start()
        config.app = make_app(jobs, token=TOKEN, hosts=("*",))
        watching = asyncio.create_task(watch())
        await server.serve()
        watching.cancel()

    thread = threading.Thread(target=asyncio.run, args=(run(),))
    thread.start()
    wait_until(lambda: server.started)
    port = server.servers[0].sockets[0].getsockname()[1]
    yield Served(Client(port, 0), server, jobs, delays)
    server.should_exit = True
    thread.join()


def send(served, text: bytes) -> tuple[int, bytes]:
    """Returns the status and everything else that is answered to some bytes, until the connection is closed."""
    with socket.create_connection(("127.0.0.1", served.client.port), timeout=10) as connection:
        connection.sendall(text)
        answer = b""
        while part := connection.recv(2**16):
            answer += part
    return int(answer.split(b" ")[1]), answer


def get(path: str, *headers: str) -> bytes:
    return "\r\n".join([f"GET {path} HTTP/1.1", "Connection: close", *headers, "", ""]).encode("latin-1")


def ask(served, path: str, body=None, method: str = "POST", **headers):
    given = {"Authorization": f"Bearer {TOKEN}"} | headers
    return served.client.ask(method, path, body, given)


@pytest.mark.parametrize(
    "host", ["x/assets/?", "x/health?", "a@b", "x#", "localhost:", "localhost:x", "[::1", "", "a b", "é"]
)
def test_the_token_is_not_passed_by_with_a_name_of_the_server(served, host):
    status, answer = send(served, get("/model", f"Host: {host}"))
    assert status == 400 and b'"fps"' not in answer
    assert send(served, get("/model", f"Host: {host}", f"Authorization: Bearer {TOKEN}"))[0] == 400


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1:8000", "[::1]:80", "my_host.example", "a-b.c:1"])
def test_names_of_servers_are_taken(served, host):
    assert send(served, get("/health", f"Host: {host}"))[0] == 200


@pytest.mark.parametrize(
    "authorization",
    [TOKEN, f"Basic {TOKEN}", f"Bearer{TOKEN}", f"Token Bearer {TOKEN}", "Bearer wrong", "secrét", "Bearer", ""],
)
def test_a_token_has_its_scheme(served, authorization):
    assert send(served, get("/model", "Host: a", f"Authorization: {authorization}"))[0] == 401
    twice = get("/model", "Host: a", f"Authorization: {authorization}", f"Authorization: Bearer {TOKEN}")
    assert send(served, twice)[0] == 401
    assert send(served, get("/model", "Host: a", f"Authorization: bearer {TOKEN}"))[0] == 200


@pytest.mark.parametrize(("path", "status"), [("/", 200), ("/health", 200), ("/model", 401), ("/metrics", 401)])
def test_the_page_and_its_health_need_no_token(served, path, status):
    assert send(served, get(path, "Host: a"))[0] == status


@pytest.mark.parametrize(
    "origins",
    [
        ["https://a:80"],  # another scheme
        ["http://a:80", "http://evil.example"],
        ["http://evil.example", "http://a:80"],
        ["a:80"],
        ["null"],
        ["http://a"],
        ["ftp://a:80"],
    ],
)
def test_a_page_of_another_origin_is_refused(served, origins):
    headers = ["Host: a:80", f"Authorization: Bearer {TOKEN}", *(f"Origin: {origin}" for origin in origins)]
    assert send(served, get("/model", *headers))[0] == 403
    assert send(served, get("/model", *headers[:2], "Origin: http://a:80"))[0] == 200


def test_two_lengths_of_a_body_close_the_connection(served):
    head = "POST /scene HTTP/1.1\r\nHost: a\r\nContent-Length: 4\r\nTransfer-Encoding: chunked\r\n\r\n"
    smuggled = "0\r\n\r\nGET /health HTTP/1.1\r\nHost: a\r\n\r\n"
    status, answer = send(served, (head + smuggled).encode())
    assert status == 400 and answer.count(b"HTTP/1.1 ") == 1


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("/motions", '{"captions": [' + '"a", ' * (MAX_BODY // 6) + '"a"]}'),
        ("/motions", '{"captions": ["a"], "start": [' + "1, " * (MAX_BODY // 4) + "1]}"),
        ("/motions", '{"captions": ["a"], ' + '"x": "a", ' * (MAX_BODY // 11) + '"y": 1}'),
        ("/motions", '{"captions": ["' + "a b" * (MAX_BODY // 4) + '"]}'),
        ("/motions", '"' * (MAX_BODY - 10)),
        ("/motions", "[" * (MAX_BODY - 10)),
        ("/files", '{"motions": [' + '"AAAA", ' * (MAX_BODY // 9) + '"a"]}'),
        ("/files", '{"motions": [' + f'"{"A" * 1004}", ' * (MAX_BODY // 1010) + '"a"]}'),
        ("/files", '{"motions": ["' + "A" * (MAX_BODY - 50) + '"]}'),
        ("/motions", '{"captions": ["a"], "start": "' + "A" * (MAX_BODY - 50) + '"}'),
        ("/character", '{"motions": ["AAAA"], "character": "' + "A" * (MAX_CHARACTER_BODY - 64) + '"}'),
        ("/character", '{"motions": ["AAAA"], "character": [' + "1, " * (MAX_CHARACTER_BODY // 4) + "1]}"),
    ],
)
def test_a_large_body_does_not_stop_others(served, path, text):
    del served.delays[:]
    answer = ask(served, path, text.encode(), **JSON)
    assert answer.status == 400 and len(answer.body) < 1000
    assert max(served.delays) < 0.2


def test_long_sentences_do_not_stop_others(served):
    del served.delays[:]
    before = len(served.jobs.sent)
    fields = {"captions": ["he walks, then he waves", *["walks then waves then " * 45] * 19]}
    connection = served.client.open("POST", "/motions", fields, {"Authorization": f"Bearer {TOKEN}"})
    wait_until(lambda: len(served.jobs.sent) > before)
    connection.close()
    assert max(served.delays) < 0.2
    assert served.jobs.sent[before].request.captions[:2] == ("he walks", "he waves")


def test_of_two_requests_with_one_key_only_the_first_is_kept(served):
    fields = {"captions": ["walks then waves then " * 45] * 20}
    headers = {"Authorization": f"Bearer {TOKEN}"}
    connections = [served.client.open("POST", "/motions?keep=0123456789abcdef", fields, headers) for _ in range(2)]
    statuses = sorted(connection.getresponse().status for connection in connections)
    served.client.ask("DELETE", "/motions/0123456789abcdef", headers=headers)
    for connection in connections:
        connection.close()
    assert statuses == [200, 409]


def test_what_is_always_the_same_is_made_once(served, monkeypatch):
    """Anybody may ask for it as often as they like, without a token."""
    for name in ("openapi", "viewer_script", "stage_style"):
        monkeypatch.delattr(f"t2m_jax.serving.app.{name}")
    for path in ("/openapi.json", "/assets/viewer.js", "/assets/stage.css"):
        assert served.client.ask("GET", path).status == 200


def test_json_without_a_motion_is_small(served):
    text = json.dumps({"captions": ["a"], "x" * 30: "b c" * MAX_JSON})
    answer = ask(served, "/motions", text.encode(), **JSON)
    assert answer.status == 400 and "without the motions" in answer.json["error"]


def test_all_large_bodies_together_have_a_limit_and_small_ones_have_room():
    class Fake:
        def __init__(self, size):
            self.size = size

        async def stream(self):
            yield b"x" * self.size

    async def run():
        bodies = Bodies()
        held = [bodies.read(Fake(MAX_BODY)) for _ in range(MAX_BODIES // MAX_BODY)]
        for one in held:
            await one.__aenter__()
        with pytest.raises(Exception, match="too many files") as caught:
            async with bodies.read(Fake(MAX_BODY)):
                pass
        assert caught.value.status_code == 429
        async with bodies.read(Fake(MAX_JSON)) as body:
            assert len(body) == MAX_JSON
        for one in held:
            await one.__aexit__(None, None, None)
        assert bodies.size == 0

    asyncio.run(run())


FILES = HOSTILE_FILES | {
    "npz": [*HOSTILE_FILES["npz"], npz_with(fps=1000.0, positions=np.zeros((MAX_FRAMES + 1, 22, 3), "f4"))]
}


@pytest.mark.parametrize(("suffix", "data"), [(suffix, data) for suffix, found in FILES.items() for data in found])
def test_a_file_that_cannot_be_read_fails_alone_in_one_line(served, suffix, data):
    answer = ask(served, f"/scene?format={suffix}", data)
    assert answer.status == 400 and answer.json["error"].startswith(f"motion.{suffix}: ")
    fields = {"captions": ["a"], "start": base64.b64encode(data).decode(), "start_format": suffix, "strength": 0.5}
    answer = ask(served, "/motions", json.dumps(fields).encode(), **JSON)
    assert answer.status == 400 and answer.json["error"].startswith("start: ")


@pytest.mark.parametrize("query", ["fps=120&speed=0.1", "fps=120&speed=0.1&begin=1"])
def test_a_change_that_makes_a_motion_too_long_is_refused(served, query):
    data = npz_with(positions=np.zeros((12_000, 22, 3), "f4"))
    answer = ask(served, f"/scene?format=npz&{query}", data)
    assert answer.status == 400 and "frames" in answer.json["error"]
