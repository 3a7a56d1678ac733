"""Loads a server with many clients at once, and misuses it: `make soak-serve`.

Prints a table for `docs/serving.md`. Exits with 1 if a request got no answer, an error other than 429 and 503, or
another motion than it gets alone, or if memory grows.
"""

import argparse
import asyncio
import json
import os
import random
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from tests.serving.conftest import Client, running_server

SENTENCES = (
    "a person walks forward",
    "a person walks backward slowly",
    "a person waves with the left hand",
    "an old man waves with the right hand",
    "a person runs in a circle",
    "somebody jogs",
    "a person dances happily",
    "a person bows politely",
    "a person kicks",
    "a person swims north",
)
GROWTH = 1.1
"""Memory after all requests, as a multiple of that after a quarter of them, that is not flat any more."""
BIG = 17 * 2**20
"""Bytes of a body that is too large."""
KINDS = {"one": 70, "three": 5, "chain": 4, "vary": 3, "leave": 6, "slow": 4, "file": 4, "big": 2, "broken": 2}
"""What clients do, and how often in a hundred requests."""


NUM_PAIRS = 40
"""Sentences with seeds whose motions are compared."""
LABELS = {
    "one": "asked for one motion",
    "three": "asked for three samples",
    "chain": "asked for two sentences in turn",
    "vary": "varied a motion",
    "leave": "left while they waited",
    "slow": "read 50 kB/s",
    "file": "asked for a GLB file",
    "big": "sent 17 MiB, answered with 413",
    "broken": "sent broken JSON, answered with 400",
    "done": "motions that came",
}


class Reply(NamedTuple):
    """What came back: `events` are pairs of a name and data."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def last(self) -> tuple[str, bytes]:
        """The name and the JSON text of the last event."""
        name, _, data = self.body.rstrip().rpartition(b"\n\n")[2].partition(b"\n")
        return name.decode().removeprefix("event: "), data.removeprefix(b"data: ")


async def ask(port: int, path: str, body: bytes, *, first: bytes = b"", rate: int = 0, leave: bool = False) -> tuple:
    """Sends one request.

    Args:
        port: Where the server is.
        path: Starts with `/`.
        body: JSON or a file.
        first: The time until these bytes have come is measured, too.
        rate: Bytes per second that are read; 0 for all at once.
        leave: Close the connection at `first`.

    Returns:
        The reply, the seconds until `first`, and the seconds in total.
    """
    kind = b"application/json" if body[:1] == b"{" else b"application/octet-stream"
    head = f"POST {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: {len(body)}\r\n"
    start, first_seconds = time.perf_counter(), None
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=2**20)
    received = bytearray()
    try:
        writer.write(head.encode() + b"Content-Type: " + kind + b"\r\n\r\n" + body)
        while part := await reader.read(max(rate // 10, 1) if rate else 2**20):
            received += part
            if first and first_seconds is None and first in received:
                first_seconds = time.perf_counter() - start
                if leave:
                    break
            if rate:
                await asyncio.sleep(0.1)
    except (ConnectionError, BrokenPipeError):  # the server has refused the body, and does not read the rest
        pass
    finally:
        writer.close()
    top, _, rest = bytes(received).partition(b"\r\n\r\n")
    lines = top.decode("latin-1").split("\r\n")
    headers = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines[1:])}
    status = int(lines[0].split(" ")[1]) if lines[0] else 0
    body = _joined(rest) if headers.get("transfer-encoding") == "chunked" else rest
    return Reply(status, headers, body), first_seconds, time.perf_counter() - start


def _joined(body: bytes) -> bytes:
    """Returns a body that came in chunks."""
    parts = []
    while body:
        size, _, rest = body.partition(b"\r\n")
        if not size or int(size, 16) == 0:
            break
        parts.append(rest[: int(size, 16)])
        body = rest[int(size, 16) + 2 :]
    return b"".join(parts)


class Soak:
    """Clients of one server, and what happened to them."""

    def __init__(self, port: int):
        """Takes where the server is."""
        self.port = port
        self.alone: dict[tuple[str, int], bytes] = {}
        """The last event of each sentence and seed if nothing else happens."""
        self.counts: Counter[str] = Counter()
        self.broken: list[str] = []
        self.seconds: list[float] = []

    @property
    def npz(self) -> str:
        """A motion to send back, in base64."""
        return str(json.loads(self.alone[self.pair(0)])["motions"][0]["npz"])

    @staticmethod
    def pair(number: int) -> tuple[str, int]:
        """Returns one of the sentences with seeds."""
        number %= NUM_PAIRS
        return SENTENCES[number % len(SENTENCES)], number // len(SENTENCES)

    async def motion(self, sentence: str, seed: int) -> None:
        """Asks for a motion, and compares it."""
        reply, _, seconds = await self.patient({"captions": [sentence], "seed": seed})
        if (data := self.done(reply)) is not None:
            self.seconds.append(seconds)
            if self.alone.setdefault((sentence, seed), data) != data:
                self.broken.append(f"{sentence!r} with seed {seed} is another motion than before")

    async def patient(self, fields: dict, **options) -> tuple:
        """Asks for motions again and again, as the server tells."""
        while True:
            answer = await ask(self.port, "/motions", json.dumps(fields).encode(), **options)
            status = answer[0].status
            if status not in (429, 503):
                return answer
            self.counts[f"{status}, tried again"] += 1
            if not answer[0].headers.get("retry-after", "").isdigit():
                self.broken.append(f"{status} without Retry-After")
            await asyncio.sleep(int(answer[0].headers.get("retry-after", 1)))

    def done(self, reply: Reply) -> bytes | None:
        """Returns the JSON text of a motion, or notes what came instead."""
        if reply.status != 200:
            self.broken.append(f"status {reply.status}: {reply.body[:100]!r}")
            return None
        name, data = reply.last
        self.counts[name] += 1
        if name != "done":
            self.broken.append(f"{name}: {data[:200]!r}")
            return None
        return data

    async def act(self, kind: str, number: int) -> None:
        """Does one of `KINDS`."""
        sentence, seed = self.pair(number)
        self.counts[kind] += 1
        if kind == "one":
            await self.motion(sentence, seed)
        elif kind == "three":
            self.done((await self.patient({"captions": [sentence], "seed": seed, "num_samples": 3}))[0])
        elif kind == "chain":
            self.done((await self.patient({"captions": [sentence, SENTENCES[0]], "seed": seed}))[0])
        elif kind == "vary":
            fields = {"captions": [sentence], "seed": seed, "strength": 0.3}
            reply, _, _ = await self.patient(fields | {"start": self.npz})
            if reply.status == 200 and b"has died while it worked" in reply.last[1]:
                self.counts["not tried again, because its file may have ended the process"] += 1
            else:
                self.done(reply)
        elif kind == "slow":
            reply, _, _ = await self.patient({"captions": [sentence], "seed": seed}, rate=50_000)
            self.done(reply)
        elif kind == "leave":
            await self.patient({"captions": [sentence]}, first=b"event: ", leave=True)
        else:
            await self._other(kind)

    async def _other(self, kind: str) -> None:
        """Asks for a file, or sends what must be refused."""
        body = {"big": b"x" * BIG, "broken": b'{"captions": [', "file": b""}[kind]
        if kind == "file":
            body = json.dumps({"motions": [self.npz]}).encode()
        path = "/motions" if kind == "broken" else "/files?format=glb"
        reply, _, _ = await ask(self.port, path, body)
        expected = {"big": (413, 0), "broken": (400,), "file": (200, 429)}[kind]
        if reply.status not in expected:
            self.broken.append(f"{kind}: status {reply.status}: {reply.body[:100]!r}")


async def crowd(soak: Soak, kinds: list[str], num_clients: int) -> float:
    """Does the actions with so many clients at a time, and returns the seconds."""
    numbered = list(enumerate(kinds))[::-1]

    async def client() -> None:
        while numbered:
            number, kind = numbered.pop()
            await soak.act(kind, number)

    start = time.perf_counter()
    await asyncio.gather(*(client() for _ in range(num_clients)))
    return time.perf_counter() - start


def num_restarts(client: Client) -> int:
    """Returns how many processes that generate were lost, and replaced."""
    found = re.search(r"t2m_worker_restarts_total (\d+)", client.ask("GET", "/metrics").body.decode())
    return int(found[1])


def processes(pid: int) -> dict[int, int]:
    """Returns the bytes of memory of a process and of those below it."""
    found = {}
    for child in [pid, *(int(text) for text in Path(f"/proc/{pid}/task/{pid}/children").read_text().split())]:
        try:
            pages = int(Path(f"/proc/{child}/statm").read_text().split()[1])
        except (FileNotFoundError, ProcessLookupError, IndexError):
            continue
        found[child] = pages * os.sysconf("SC_PAGE_SIZE")
        if child != pid:
            found |= processes(child)
    return found


async def kill_workers(pid: int, times: int, every: float) -> None:
    """Kills the process that generates again and again: the one with the most memory below the server."""
    for _ in range(times):
        await asyncio.sleep(every)
        below = {child: size for child, size in processes(pid).items() if child != pid}
        if below:
            os.kill(max(below, key=below.__getitem__), signal.SIGKILL)


def batch_rate(model: str, batch: int) -> float:
    """Returns the motions per second of `t2m bench sample`, which has no server around it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sample.json"
        command = [sys.executable, "-m", "t2m_jax", "bench", "sample", "--model", model, "--batch", str(batch)]
        subprocess.run([*command, "--json", str(path)], check=True, stdout=subprocess.DEVNULL)
        (row,) = json.loads(path.read_text(encoding="utf-8"))["rows"]
    milliseconds = next(one["value"] for one in row["figures"] if one["name"] == "per row")
    return 1000 / (milliseconds * int(row["name"].split(" rows")[0].rpartition(" ")[2]))


class Table:
    """The rows of the result, printed as they come."""

    def __init__(self) -> None:
        """Prints the head."""
        print("| what | figure |\n| --- | ---: |", flush=True)

    def add(self, name: str, figure: str) -> None:
        """Prints a row."""
        print(f"| {name} | {figure} |", flush=True)

    def add_seconds(self, name: str, seconds: list[float]) -> None:
        """Prints the median and the 95th percentile."""
        ordered = sorted(seconds)
        most = ordered[min(int(0.95 * len(ordered)), len(ordered) - 1)]
        self.add(name, f"{statistics.median(ordered):.2f} s, {most:.2f} s")


async def alone(soak: Soak, table: Table) -> None:
    """Measures one client, and keeps what every sentence and seed gives when nothing else happens."""
    await soak.motion(*soak.pair(0))
    firsts = []
    for number in range(NUM_PAIRS):
        sentence, seed = soak.pair(number)
        body = json.dumps({"captions": [sentence], "seed": seed}).encode()
        reply, first, seconds = await ask(soak.port, "/motions", body, first=b'"scene":{')
        if (data := soak.done(reply)) is not None:
            soak.alone[sentence, seed] = data
            soak.seconds.append(seconds)
            firsts.append(seconds if first is None else first)
    table.add_seconds("1 client: first frames, median and 95th percentile", firsts)
    table.add_seconds("1 client: motion, median and 95th percentile", soak.seconds)


async def measure(client: Client, options: argparse.Namespace, table: Table) -> list[str]:
    """Does everything, and returns what is broken."""
    soak = Soak(client.port)
    await alone(soak, table)

    drawn = random.Random(options.seed).choices([*KINDS], [*KINDS.values()], k=options.requests - options.requests // 2)
    half = len(drawn) // 2
    await crowd(soak, drawn[:half], options.clients)  # afterwards everything is compiled
    first_memory = sum(processes(client.pid).values())

    soak.seconds.clear()
    count = options.requests // 2
    duration = await crowd(soak, ["one"] * count, options.clients)
    rate = count / duration
    table.add(f"{options.clients} clients: motions per second", f"{rate:.1f}")
    table.add_seconds(f"{options.clients} clients: motion, median and 95th percentile", soak.seconds)
    await crowd(soak, drawn[half:], options.clients)
    last_memory = sum(processes(client.pid).values())
    table.add(
        "memory of all processes after a quarter of the requests, after all",
        f"{first_memory / 1e9:.2f}, {last_memory / 1e9:.2f} GB",
    )
    if last_memory > GROWTH * first_memory:
        soak.broken.append(f"memory grew from {first_memory:,} to {last_memory:,} bytes")

    await crowd(soak, ["one"] * 3 * options.clients, 3 * options.clients)  # more than the queue takes
    killing = asyncio.create_task(kill_workers(client.pid, options.kills, every=10))
    while not killing.done():
        await crowd(soak, ["one"] * options.clients, options.clients)
    await crowd(soak, ["one"] * options.clients, options.clients)
    table.add("killed processes, processes started in their place", f"{options.kills}, {num_restarts(client)}")
    for name, number in sorted(soak.counts.items()):
        table.add(LABELS.get(name, name), f"{number:,}")
    table.add("motions that differ from those alone, wrong errors, requests without an answer", str(len(soak.broken)))
    return soak.broken


def main() -> int:
    """Runs the soak, and returns its exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", default="demo")
    parser.add_argument("--clients", type=int, default=50)
    parser.add_argument("--requests", type=int, default=2000)
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    table = Table()
    rates = [batch_rate(options.model, options.batch)]
    with running_server("--model", options.model, "--batch", str(options.batch)) as client:
        broken = asyncio.run(measure(client, options, table))
    rates.append(batch_rate(options.model, options.batch))
    figures = " and ".join(f"{rate:.1f}" for rate in rates)
    table.add(f"`t2m bench sample --batch {options.batch}` before and after: motions per second", figures)
    for line in dict.fromkeys(broken):
        print(line, file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
