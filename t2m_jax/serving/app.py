"""The HTTP interface: the page, motions as server-sent events, and files. `docs/serving.md` describes it."""

import asyncio
import hmac
import importlib.resources
import re
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from typing import Any

import anyio
from anyio import BrokenWorkerProcess, CapacityLimiter, to_process, to_thread
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from t2m_jax.errors import UserError
from t2m_jax.export.html import STUDIO_SCRIPTS, stage_style, viewer_script
from t2m_jax.motion.changes import Changes
from t2m_jax.records import record_from
from t2m_jax.sampling.request import MotionRequest
from t2m_jax.serving import answers, schema
from t2m_jax.serving.files import Names, apart, make_file, move_character, open_file, read_motion
from t2m_jax.serving.jobs import FINAL_EVENTS, TRY_AGAIN, Event, Job, Jobs, QueueFullError
from t2m_jax.serving.kept import KeptAnswers
from t2m_jax.serving.openapi import openapi
from t2m_jax.serving.streams import Bodies, EventResponse, is_json, while_connected
from t2m_jax.serving.wording import in_browser

LOOPBACK = ("127.0.0.1", "localhost", "::1", "[::1]")
ANSWER_SECONDS = 600.0
"""Longest time in the queue and in generation together."""
ALIVE_SECONDS = 10.0
"""After this time without an event, a comment is sent: proxies close silent connections."""
FILE_SECONDS = 120.0
"""Longest time to make a file."""
MAX_FILES = 16
"""Requests for files that may wait; one is worked on."""
HEADERS = {
    # Textures of characters are parts of their files: blobs, which three.js fetches.
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data: blob:; connect-src 'self' data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
HOST = re.compile(rb"([\w.-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?", re.ASCII)
"""What the header `Host` may be: a name or an address, and perhaps a port."""
MEDIA_TYPES = {"html": "text/html; charset=utf-8", "css": "text/css", "js": "text/javascript"}


def make_app(jobs: Jobs, *, token: str | None = None, hosts: tuple[str, ...] = LOOPBACK) -> ASGIApp:
    """Returns the application.

    Args:
        jobs: The queue, started.
        token: What requests must bring in `Authorization: Bearer TOKEN`; None if everybody may ask.
        hosts: Names that the server may be called; `*` for any. With others, a strange page could reach a server on
            this machine through a name of its own.
    """
    server = _Server(jobs)
    routes = [
        Route("/", _static("index.html")),
        *[Route(f"/assets/{name}", _static(name)) for name in page_files() if name != "index.html"],
        Route("/assets/stage.css", _fixed(stage_style(), MEDIA_TYPES["css"])),
        Route("/assets/viewer.js", _fixed(viewer_script(*STUDIO_SCRIPTS), MEDIA_TYPES["js"])),
        Route("/openapi.json", _fixed(JSONResponse(openapi()).body, "application/json")),
        Route("/health", server.health),
        Route("/metrics", server.metrics),
        Route("/model", server.model),
        Route("/motions", server.motions, methods=["POST"]),
        Route("/motions/{key}", server.kept_motions, methods=["GET", "DELETE"]),
        Route("/files", server.files, methods=["POST"]),
        Route("/scene", server.scene, methods=["POST"]),
        Route("/character", server.character, methods=["POST"]),
    ]
    middleware = [
        Middleware(_Guard, token=token),
        # Against DNS rebinding: a strange page could call this machine by a name of its own.
        Middleware(TrustedHostMiddleware, allowed_hosts=list(hosts), www_redirect=False),
    ]
    handlers: dict[Any, Callable[..., Response]] = {
        UserError: lambda _, error: _error(400, in_browser(error)),
        HTTPException: lambda _, error: _error(error.status_code, error.detail, error.headers),
        QueueFullError: lambda _, error: _error(429, str(error), {"Retry-After": str(error.retry_after)}),
        ClientDisconnect: lambda *_: Response(status_code=499),
        Exception: lambda *_: _error(500, "the server has failed; its log says why", HEADERS),
    }
    return Starlette(routes=routes, middleware=middleware, exception_handlers=handlers)


def page_files() -> list[str]:
    """Returns the names of the files of the page."""
    folder = importlib.resources.files("t2m_jax.serving") / "page"
    return sorted(file.name for file in folder.iterdir() if file.name.rpartition(".")[2] in MEDIA_TYPES)


def _static(name: str) -> Callable[[Request], Response]:
    """Returns what answers with a file of the page. It is read once, so no path comes from a request."""
    content = (importlib.resources.files("t2m_jax.serving") / "page" / name).read_bytes()
    return _fixed(content, MEDIA_TYPES[name.rpartition(".")[2]])


def _fixed(content: bytes | memoryview | str, media_type: str) -> Callable[[Request], Response]:
    """Returns what always answers with the same content, which is made once."""
    return lambda _: Response(content, media_type=media_type)


def _error(status: int, message: str, headers: Any = None) -> Response:
    data: answers.ErrorData = {"error": message}
    if headers and "Retry-After" in headers:
        data["retry_after"] = int(headers["Retry-After"])
    return JSONResponse(data, status, headers)


class _Guard:
    """Refuses requests without the token and from pages of other servers (CSRF), and adds headers to all answers."""

    OPEN = ("/", "/assets/", "/health", "/openapi.json")

    def __init__(self, app: ASGIApp, token: str | None):
        self.app = app
        self.token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] += [(key.lower().encode(), value.encode()) for key, value in HEADERS.items()]
            await send(message)

        answer = self._refusal(scope)
        await (answer or self.app)(scope, receive, send_with_headers)

    def _refusal(self, scope: Scope) -> Response | None:
        """Returns the answer to a request that is refused by its headers."""
        headers: dict[bytes, list[bytes]] = {}
        for name, value in scope["headers"]:
            headers.setdefault(name, []).append(value)
        # Request smuggling (RFC 9112, 6.1): a proxy may have taken the other one of the two for the length of the body.
        if b"content-length" in headers and b"transfer-encoding" in headers:
            closing = {"Connection": "close"}
            return _error(400, "a request has Content-Length or Transfer-Encoding, not both", closing)
        hosts = headers.get(b"host", [])
        if len(hosts) != 1 or not HOST.fullmatch(hosts[0]):
            return _error(400, "the header Host must be there once, as NAME or NAME:PORT")
        # Against CSRF: browsers say which page sends a request, and only the page of this server may.
        own = scope["scheme"].encode() + b"://" + hosts[0]
        if any(origin != own for origin in headers.get(b"origin", [])):
            return _error(403, "requests from other pages are refused")
        # Not the path of `request.url`: in old versions of Starlette, the header Host is a part of that.
        path = scope["path"]
        if self.token is None or path in self.OPEN or path.startswith("/assets/"):
            return None
        scheme, _, given = b",".join(headers.get(b"authorization", [])).partition(b" ")
        # In constant time, so that answers do not tell how much of a guess is right.
        if hmac.compare_digest(given.strip(), self.token.encode()) and scheme.lower() == b"bearer":
            return None
        return _error(401, "a token is needed: Authorization: Bearer TOKEN", {"WWW-Authenticate": "Bearer"})


class _Server:
    """The answers that need the queue."""

    def __init__(self, jobs: Jobs):
        self.jobs = jobs
        self.file_limit = CapacityLimiter(1)
        self.files_waiting = 0
        self.bodies = Bodies()
        self.kept = KeptAnswers()
        bodies = {"motions": schema.MotionBody, "files": schema.FileParameters, "scene": schema.SceneParameters}
        self.fields = {name: body.model_json_schema()["properties"] for name, body in bodies.items()}

    def health(self, _: Request) -> Response:
        """Answers whether motions can be made."""
        alive = self.jobs.is_alive
        health: answers.HealthData = {
            "status": "ok" if alive else "restarting",
            "model": self.jobs.model_name,
            "waiting": len(self.jobs.waiting),
        }
        return JSONResponse(health, 200 if alive else 503)

    def metrics(self, _: Request) -> Response:
        """Answers with the counters."""
        return Response(self.jobs.measures.text(), media_type="text/plain; version=0.0.4; charset=utf-8")

    def model(self, _: Request) -> Response:
        """Answers with what the page needs to know."""
        data = self.jobs.model | {
            "formats_of_several": schema.SEVERAL,
            "body_bytes": schema.MAX_BODY,
            "character_bytes": schema.MAX_CHARACTER,
            "fields": self.fields,
        }
        return JSONResponse(data)

    async def motions(self, request: Request) -> Response:
        """Generates: answers with server-sent events, or with one JSON object to who asks for it."""
        if not is_json(request):  # a page of another server could only send other types of bodies unasked
            raise HTTPException(415, "the body must be application/json")
        key = schema.read_parameters(schema.KeepParameters, request.query_params.multi_items()).get("keep")
        async with self.bodies.read(request) as body:
            fields = await to_thread.run_sync(schema.read_body, schema.MotionBody, body)
            start = None
            # Files of strangers are not read in the process that generates: a crash there would concern all users.
            if fields.get("start") is not None:
                start = await self._in_process(
                    read_motion, fields["start"], fields.get("start_format", "npz"), None, Names("start")
                )
        # To read long sentences takes longer than others should wait.
        asked = await to_thread.run_sync(self._read, schema.motion_request(fields, start))
        schema.check_lengths(asked)
        if key is not None:
            self.kept.check(key)  # no other request may come between this and `start`
        events = self._events(self.jobs.submit(asked))
        return await self._answer(request, events if key is None else self.kept.start(key, events))

    def _read(self, request: MotionRequest) -> MotionRequest:
        """Returns a request with its sentences in turn, of which all is read that the queue asks for."""
        asked = request.in_turn(self.jobs.knowledge)
        asked.is_plain  # noqa: B018 - what sentences say is kept when it was read
        return asked

    async def kept_motions(self, request: Request) -> Response:
        """Answers with the motions of a request that goes on without its reader, or forgets them."""
        key = request.path_params["key"]
        if request.method == "DELETE":
            self.kept.forget(key)
            return Response(status_code=204)
        return await self._answer(request, self.kept.follow(key))

    async def _answer(self, request: Request, events: AsyncIterator[Event | None]) -> Response:
        if "application/json" in request.headers.get("accept", ""):
            return await self._final_answer(events, request.receive)
        return EventResponse(events)

    async def _events(self, job: Job) -> AsyncGenerator[Event | None, None]:
        """Yields the events of a job up to the last, and None after a time without one."""
        start = anyio.current_time()
        result = "cancelled"
        try:
            while True:
                event = None
                try:
                    event = await asyncio.wait_for(job.events.get(), ALIVE_SECONDS)
                except TimeoutError:
                    if anyio.current_time() - start > ANSWER_SECONDS:
                        job.tell("failed", {"error": f"no motion after {ANSWER_SECONDS:g} s; try again later"})
                if event is not None and event.name in FINAL_EVENTS:
                    result = event.name
                yield event
                if result in FINAL_EVENTS:
                    return
        finally:  # also if the client has closed the connection
            self.jobs.cancel(job)
            self.jobs.measures.answers.labels(result).inc()
            self.jobs.measures.seconds.observe(anyio.current_time() - start)
            if result == "done":
                self.jobs.measures.motions.inc(job.request.num_samples)

    async def _final_answer(self, events: AsyncIterator[Event | None], receive: Receive) -> Response:
        last = None
        async with while_connected(receive):
            async for event in events:
                last = event
        if last is None or last.name not in FINAL_EVENTS:
            raise ClientDisconnect
        return Response(last.data, 200 if last.name == "done" else 422, media_type="application/json")

    async def files(self, request: Request) -> Response:
        """Answers with a file for download."""
        fields = schema.read_parameters(schema.FileParameters, request.query_params.multi_items())
        options = record_from(schema.FileOptions, fields)
        async with self.bodies.read(request) as body:
            inputs = [body]
            if is_json(request):
                inputs = (await to_thread.run_sync(schema.read_body, schema.FileBody, body))["motions"]
            content = await self._in_process(make_file, inputs, options)
        disposition = f'attachment; filename="motion.{options.format}"'
        return Response(content, headers={"Content-Disposition": disposition}, media_type="application/octet-stream")

    async def scene(self, request: Request) -> Response:
        """Answers with what the page shows of a motion file."""
        fields = schema.read_parameters(schema.SceneParameters, request.query_params.multi_items())
        suffix = fields.get("format", "npz")
        rig = fields.pop("rig", None)
        names = Names(fields.pop("name", f"motion.{suffix}"), fields.pop("rig_name", "rig"))
        split = fields.pop("split", None)
        changes = record_from(Changes, fields)
        async with self.bodies.read(request) as body:
            opened = await self._in_process(open_file, body, suffix, changes, rig, names, split)
        return Response(opened, media_type="application/json")

    async def character(self, request: Request) -> Response:
        """Answers with a user's character that moves."""
        if not is_json(request):
            raise HTTPException(415, "the body must be application/json")
        fields = schema.read_parameters(schema.CharacterParameters, request.query_params.multi_items())
        names = Names(fields.pop("name", "character"), fields.pop("rig_name", "rig"))
        rig = fields.pop("rig", None)
        changes = record_from(Changes, fields)
        async with self.bodies.read(request, schema.MAX_CHARACTER_BODY) as body:
            given = await to_thread.run_sync(schema.read_body, schema.CharacterBody, body)
            content = await self._in_process(move_character, given["character"], given["motions"], changes, rig, names)
        disposition = 'attachment; filename="character.glb"'
        return Response(content, headers={"Content-Disposition": disposition}, media_type="model/gltf-binary")

    async def _in_process(self, function: Callable[..., Any], *args: Any) -> Any:
        """Returns what a function returns in a process of its own, which is killed if it takes too long."""
        if self.files_waiting >= MAX_FILES:
            raise HTTPException(429, "too many files are waiting; try again in 5 s", {"Retry-After": "5"})
        self.files_waiting += 1
        try:
            # A thread could not be stopped if a file takes forever, and would not survive a crash of a decoder.
            with anyio.fail_after(FILE_SECONDS):
                return await to_process.run_sync(apart, function, *args, cancellable=True, limiter=self.file_limit)
        except BrokenWorkerProcess:
            raise HTTPException(503, "the process that makes files has died; try again", {"Retry-After": "1"}) from None
        except TimeoutError:
            raise HTTPException(503, f"no file after {FILE_SECONDS:g} s; {TRY_AGAIN}", {"Retry-After": "60"}) from None
        finally:
            self.files_waiting -= 1
