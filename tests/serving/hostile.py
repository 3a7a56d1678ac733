"""Sends hostile requests to a server beside a user who wants motions and one who pings: `make soak-hostile`.

Prints a table for `docs/serving.md`. Exits with 1 if a request was answered with 500 or not at all, if a process was
lost, if the event loop stood still, or if the user got other motions than alone, or waited much longer for them.
"""

import argparse
import asyncio
import base64
import http.client
import io
import json
import multiprocessing
import os
import random
import re
import statistics
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, get_args

import numpy as np

from t2m_jax.serving.schema import InputFormat
from tests.fuzz.mutations import mutate
from tests.motion.character_files import write_character
from tests.motion.rig.test_retarget import BANDAI
from tests.serving.conftest import Client, running_server
from tests.serving.soak import Soak, Table, num_restarts, processes

CLIENTS = 16
"""Connections of the attack at a time."""
WAIT = 60.0
"""Seconds after which a request has got no answer."""
LONGEST_STOP = 0.2
"""Seconds for which the event loop may stand still."""
SLOWER = 3.0
"""Times as long that the user may wait as alone."""
ANSWERS = {200, 204, 307, 400, 401, 403, 404, 405, 408, 411, 413, 415, 421, 429, 431, 499, 503}
"""What a server may say; 500 is a fault of the server."""
VALUES = (
    *(None, True, -1, 0, 1, 2**31, 2**64, 10**400, 1e308, -0.0, 0.1, "", "a", "\0", "\ud800", "../../etc/passwd"),
    *("🕺" * 50, "9" * 5000, "nan", [], {}, [[]], [None], ["a"] * 3000, [0] * 3000, {"": {}}, "a person walks " * 500),
    "1 a=x" + " " * 20_000 + "y",
)
"""What a field of JSON may hold that nobody expects."""
NESTED = "a list in a list in a list"
"""Stands for a value that Python's own writer of JSON refuses."""


def change_json(data: Any, draws: random.Random) -> Any:
    """Returns a copy of JSON in which one value, or one name, is another."""
    if isinstance(data, dict) and data and draws.random() < 0.8:
        name = draws.choice(sorted(data))
        if draws.random() < 0.1:
            return {(name[:-1] if key == name else key): value for key, value in data.items()}
        return data | {name: change_json(data[name], draws)}
    if isinstance(data, list) and data and draws.random() < 0.5:
        place = draws.randrange(len(data))
        return [*data[:place], change_json(data[place], draws), *data[place + 1 :]]
    return draws.choice((*VALUES, NESTED))


class Requests:
    """Draws hostile requests."""

    def __init__(self, npz: str, seed: int):
        """Takes a motion to send back, in base64, and the start of all random choices."""
        self.npz, self.draws = npz, random.Random(seed)
        with tempfile.TemporaryDirectory() as folder:
            self.glb = base64.b64encode(write_character(Path(folder) / "a.glb", BANDAI).read_bytes()).decode()
        joints = io.BytesIO()
        np.save(joints, np.zeros((20, 22, 3), np.float32))
        self.npy = base64.b64encode(joints.getvalue()).decode()

    def body(self) -> tuple[str, dict]:
        """Returns a path and a body that the server takes."""
        edits = ({}, {"strength": 0.3}, {"span": [0.4, 1.2]}, {"seconds": 1.0}, {"num_samples": 2})
        targets = {"targets": ["1.0 right_wrist=0,1.2,0.3"]}
        options = {"temperature": 0.8, "top_k": 20, "guidance_scale": 2.0}
        start = {"start": self.npz, "start_format": "npz"}
        asked = {"captions": ["a person walks", "a person waves"], "seed": self.draws.randrange(9)}
        changes = "?format=bvh&speed=1.5&turn=90&path=0,0%200,2&begin=0.2&end=1&mirror=true&fps=30"
        found = (
            ("/motions", asked | self.draws.choice(edits)),
            ("/motions", asked | start | self.draws.choice(edits[1:3])),
            ("/motions", asked | targets | options),
            ("/files" + changes, {"motions": [self.npz]}),
            ("/files?format=" + self.draws.choice(("npz", "glb", "bvh", "html")), {"motions": [self.npz, self.npz]}),
            ("/character?name=hero.glb&speed=2", {"character": self.glb, "motions": [self.npz]}),
        )
        return self.draws.choice(found)

    def damaged_file(self) -> bytes:
        """Returns a file whose bytes or numbers are wrong."""
        return mutate(base64.b64decode(self.draws.choice((self.npz, self.glb, self.npy))), self.draws)

    def draw(self) -> tuple[bytes, bool]:
        """Returns the bytes of a request, and whether its first lines are those of a browser."""
        path, fields = self.body()
        kind = self.draws.choice(("json", "json", "text", "file", "base64", "query", "path", "head", "get"))
        body = json.dumps(fields).encode()
        if kind == "json":
            depth = self.draws.choice((3, 90, 3000, 30_000))
            changed = json.dumps(change_json(fields, self.draws))
            body = changed.replace(json.dumps(NESTED), "[" * depth + "]" * depth).encode()
        elif kind == "text":
            body = mutate(body, self.draws)
        elif kind == "base64":
            damaged = base64.b64encode(self.damaged_file()).decode()
            path, fields = self.draws.choice(
                (
                    ("/motions", {"captions": ["a"], "start": damaged, "start_format": "npz", "strength": 0.5}),
                    ("/motions", {"captions": ["a"], "start": damaged, "start_format": "glb", "strength": 0.5}),
                    ("/character", {"character": damaged, "motions": [self.npz]}),
                    ("/files?format=glb", {"motions": [self.npz, damaged]}),
                )
            )
            body = json.dumps(fields).encode()
        elif kind == "file":
            path, body = f"/scene?format={self.draws.choice(get_args(InputFormat))}", self.damaged_file()
        elif kind == "query":
            place, _, query = path.partition("?")
            path = f"{place}?{printable(mutate(query.encode() or b'format=bvh', self.draws))}"
        elif kind == "path":
            path = printable(mutate(self.draws.choice((b"/motions/0123456789abcdef", path.encode())), self.draws))
        elif kind == "get":
            path = self.draws.choice(("/openapi.json", "/model", "/metrics", "/assets/viewer.js", "/"))
        methods = {"path": ("GET", "DELETE", "PUT", "HEAD"), "get": ("GET",)}
        method = self.draws.choice(methods.get(kind, ("POST",)))
        head = f"{method} /{path.lstrip('/')} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n"
        head += f"Content-Type: application/{'octet-stream' if kind == 'file' else 'json'}\r\n"
        top = f"{head}Content-Length: {len(body)}\r\n\r\n".encode("latin-1")
        return (mutate(top, self.draws) if kind == "head" else top) + body, kind != "head"


def printable(text: bytes) -> str:
    """Returns text without what would end the first line of a request."""
    return re.sub(rb"[^!-~]", b"%", text).decode("ascii")


async def answer_to(port: int, request: bytes, *, whole: bool) -> int | None:
    """Returns the status of an answer, 0 if the connection was closed without one, and None if nothing came.

    Only its first part is read: whoever waits for a motion is gone before it is made.
    """
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(request)
        if not whole:
            writer.write_eof()  # the server may wait for more lines
        first = await asyncio.wait_for(reader.read(2**16), WAIT)
    except TimeoutError:
        return None
    except OSError:  # the connection was closed while it was written to
        return 0
    finally:
        writer.close()
    found = re.match(rb"HTTP/1\.1 (\d{3}) ", first)
    return int(found[1]) if found else 0


def attack(port: int, npz: str, seed: int, count: int) -> tuple[Counter[str], list[str]]:
    """Sends hostile requests, and returns how often each answer came, and the requests that got a wrong one."""
    requests, seen, broken = Requests(npz, seed), Counter[str](), []
    left = iter(range(count))

    async def client() -> None:
        for _ in left:
            request, whole = requests.draw()
            status = await answer_to(port, request, whole=whole)
            seen[f"{status}"] += 1
            # A body that is too large is refused before it is read, and the answer may be lost with the connection.
            may_be_lost = not whole or len(request) > 2**16
            if status not in ANSWERS and not (status == 0 and may_be_lost):
                broken.append(f"{status}: {request[:300]!r}")

    async def run() -> None:
        await asyncio.gather(*(client() for _ in range(CLIENTS)))

    asyncio.run(run())
    return seen, broken


def ping(port: int, stop: Connection) -> None:
    """Asks on one connection again and again until `stop` gets something, and then sends how long each answer took."""
    seconds = []
    connection = http.client.HTTPConnection("127.0.0.1", port)
    while not stop.poll(0.02):
        start = time.perf_counter()
        connection.request("GET", "/health")
        connection.getresponse().read()
        seconds.append(time.perf_counter() - start)
    stop.send(seconds)


async def use(soak: Soak) -> None:
    """Asks for one motion after the other, and looks at each for a second."""
    number = 0
    while True:
        await soak.motion(*soak.pair(number))
        number += 1
        await asyncio.sleep(1)


async def measure(client: Client, options: argparse.Namespace, table: Table) -> list[str]:
    """Does everything, and returns what is broken."""
    soak, spawn = Soak(client.port), multiprocessing.get_context("spawn")
    for _ in range(2):  # the second time, everything is compiled
        soak.seconds.clear()
        for number in range(40):
            await soak.motion(*soak.pair(number))
    alone, soak.seconds = soak.seconds, []
    before = sum(processes(client.pid).values())
    ours, its = spawn.Pipe()
    pinging = spawn.Process(target=ping, args=(client.port, its), daemon=True)
    pinging.start()
    its.close()  # so that `recv` ends if the process has died
    using = asyncio.create_task(use(soak))
    seen = await attack_often(soak, options)
    if using.done():
        using.result()
    using.cancel()
    ours.send("stop")
    pings = ours.recv()
    pinging.join()
    table.add_seconds("alone: motion, median and 95th percentile", alone)
    table.add_seconds("under attack: motion, median and 95th percentile", soak.seconds)
    table.add("under attack: motions", f"{len(soak.seconds):,}")
    table.add("under attack: pings, and the longest", f"{len(pings):,}, {max(pings):.3f} s")
    after = sum(processes(client.pid).values())
    table.add("memory of all processes before and after", f"{before / 1e9:.2f}, {after / 1e9:.2f} GB")
    for status, count in sorted(seen.items()):
        table.add(f"answers with {status}" if status != "0" else "closed connections", f"{count:,}")
    if lost := num_restarts(client):
        soak.broken.append(f"{lost} processes that generate were lost")
    if max(pings) > LONGEST_STOP:
        soak.broken.append(f"the event loop stood still for {max(pings):.3f} s")
    if statistics.median(soak.seconds) > SLOWER * statistics.median(alone):
        soak.broken.append("the user waited much longer than alone")
    return soak.broken


async def attack_often(soak: Soak, options: argparse.Namespace) -> Counter[str]:
    """Attacks from another process, notes what is broken, and returns how often each answer came."""
    seen, parts = Counter[str](), -(-options.requests // 1000)
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, spawn, os.nice, (15,)) as pool:  # the attack comes from other machines
        for part in range(parts):
            task = pool.submit(attack, soak.port, soak.npz, options.seed + part, 1000)
            counted, broken = await asyncio.wrap_future(task)
            seen += counted
            soak.broken += broken
            print(f"{part + 1} of {parts} thousands", file=sys.stderr, flush=True)
    return seen


def main() -> int:
    """Runs the attack, and returns its exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", default="demo")
    parser.add_argument("--requests", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    options = parser.parse_args()
    table = Table()
    with running_server("--model", options.model) as client:
        broken = asyncio.run(measure(client, options, table))
    for line in dict.fromkeys(broken):
        print(line, file=sys.stderr)
    print(f"seed {options.seed}: {len(set(broken))} kinds of problems")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
