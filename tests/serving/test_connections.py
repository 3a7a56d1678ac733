"""Connections and answers without a model: what a server does with clients that wait, and with its own bugs."""

import asyncio
import json
import socket

import pytest
import uvicorn
from uvicorn.server import ServerState

from t2m_jax.serving import serve as module
from t2m_jax.serving.app import HEADERS, make_app
from t2m_jax.serving.jobs import Jobs

HEADERS_WITHOUT_END = b"GET /health HTTP/1.1\r\nHost: localhost\r\nX-Long: "
REQUEST = b"GET /health HTTP/1.1\r\nHost: localhost\r\n\r\n"


@pytest.mark.parametrize("sent", [b"", HEADERS_WITHOUT_END, REQUEST + HEADERS_WITHOUT_END])
def test_connections_that_wait_forever_are_closed(monkeypatch, sent):
    monkeypatch.setattr(module, "IDLE_SECONDS", 0.1)

    async def run() -> bytes:
        config = uvicorn.Config(make_app(Jobs("none")), http=module.HttpProtocol, log_config=None)
        config.load()
        options = {"config": config, "server_state": ServerState(), "app_state": {}}
        server = await asyncio.get_running_loop().create_server(lambda: module.HttpProtocol(**options), "127.0.0.1", 0)
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
        writer.write(sent)
        answer = await asyncio.wait_for(reader.read(), 20)
        writer.close()
        server.close()
        return answer

    answer = asyncio.run(run())
    assert answer.count(b"HTTP/1.1") == (REQUEST in sent)


def test_answers_are_sent_at_once():
    """Nagle's algorithm would hold back each answer but the first of a connection for 40 ms."""

    async def run() -> int:
        at_once = asyncio.get_running_loop().create_future()

        def accepted(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            connection = writer.get_extra_info("socket")
            at_once.set_result(connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        async with await asyncio.start_server(accepted, sock=module._bind("127.0.0.1", 0)) as server:
            _, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
            writer.close()
            return await asyncio.wait_for(at_once, 20)

    assert asyncio.run(run())


def test_a_bug_is_told_as_json_with_the_usual_headers(monkeypatch):
    jobs, sent = Jobs("none"), []
    monkeypatch.delattr(jobs, "measures")

    async def receive():
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message):
        sent.append(message)

    scope = {
        "type": "http",
        "scheme": "http",
        "method": "GET",
        "path": "/metrics",
        "query_string": b"",
        "headers": [(b"host", b"localhost")],
    }
    with pytest.raises(AttributeError):
        asyncio.run(make_app(jobs)(scope, receive, send))
    start, body = sent
    headers = {name.decode(): value.decode() for name, value in start["headers"]}
    assert start["status"] == 500 and json.loads(body["body"])["error"].startswith("the server has failed")
    assert headers.items() >= {name.lower(): value for name, value in HEADERS.items()}.items()
