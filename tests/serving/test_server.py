"""A running server: what it answers, and to whom."""

import base64
import os
import re
import signal
import socket
import subprocess
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

import t2m_jax
from t2m_jax.serving.app import HEADERS, page_files
from t2m_jax.serving.files import make_file
from t2m_jax.serving.priority import NICENESS
from t2m_jax.serving.schema import MAX_BODY, MAX_CHARACTER_BODY, FileOptions, decode_base64
from tests.serving.conftest import wait_until
from tests.serving.hostile import attack
from tests.serving.soak import processes
from tests.serving.test_files import read_back
from tests.tiny import CAPTIONS

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def model(model_folder):
    return t2m_jax.load(str(model_folder))


def expected_motions(model, caption: str, **options) -> list:
    """Returns two motions of the library: all tests make as many, because another number is another program."""
    return model.generate(caption, num_samples=2, **options)


def motion_of(data: dict, number: int = 0):
    return read_back(decode_base64(data["motions"][number]["npz"]), "npz")


def test_motions_are_those_of_the_library(server, model):
    data = server.motions(CAPTIONS[0], seed=3, num_samples=2)
    expected = expected_motions(model, CAPTIONS[0], seed=3)
    for number, motion in enumerate(expected):
        found = motion_of(data, number)
        np.testing.assert_array_equal(found.codes, motion.codes)
        np.testing.assert_allclose(found.positions, motion.positions, atol=1e-4)
        assert (found.seed, found.caption) == (3, CAPTIONS[0])
    assert len(data["scene"]["figures"]) == 2


def test_the_events_tell_the_codes_in_turn(server):
    answer = server.ask("POST", "/motions", {"captions": [CAPTIONS[1]], "seed": 4})
    events = answer.events
    names = [name for name, _ in events]
    assert (
        names[0] == "queued" and names[-1] == "done" and answer.headers["content-type"].startswith("text/event-stream")
    )
    assert all(data["seed"] == 4 for name, data in events if name in ("queued", "started", "done"))
    told = [row for name, data in events if name == "codes" for row in data["codes"]]
    done = events[-1][1]["motions"][0]
    assert told[: len(done["codes"])] == done["codes"]  # with its stop rule, the end is only known at the end


def test_the_share_that_is_done_grows(server):
    shares = {}
    for captions, name in ((CAPTIONS[:3], "progress"), (CAPTIONS[:1], "codes")):
        events = server.ask("POST", "/motions", {"captions": list(captions), "seed": 4}).events
        shares[name] = [data["share"] for event, data in events if event == name]
        assert shares[name] == sorted(shares[name])
    assert len(shares["progress"]) >= 4 and shares["progress"][-1] == 1
    assert 0 < shares["codes"][0] <= 0.95


def test_a_seed_gives_the_same_motion_under_any_load(server):
    alone = [server.motions(caption, seed=9)["motions"][0]["npz"] for caption in CAPTIONS]

    def ask(number: int) -> str:
        return server.motions(CAPTIONS[number % 5], seed=9 + (number >= 5))["motions"][0]["npz"]

    with ThreadPoolExecutor(6) as threads:
        together = list(threads.map(ask, [0, 7, 1, 2, 8, 3, 4, 9]))
    found = [together[place] for place in (0, 2, 3, 5, 6)]
    for one, other in zip(alone, found, strict=True):
        first, second = (read_back(decode_base64(text), "npz") for text in (one, other))
        np.testing.assert_array_equal(first.positions, second.positions)


def test_requests_with_other_options_are_made_at_the_same_time(server, model):
    def ask(number: int) -> dict:
        fields = ({}, {"temperature": 0.7, "raw": True}, {"guidance_scale": 3.0}, {"num_samples": 8})[number % 4]
        return server.motions(CAPTIONS[number % 5], seed=number, **fields)

    with ThreadPoolExecutor(6) as threads:  # as many as may wait
        found = list(threads.map(ask, range(6)))
    assert [len(data["motions"]) for data in found] == [1, 1, 1, 8, 1, 1]
    for number, options in ((0, {}), (2, {"guidance_scale": 3.0}), (5, {"temperature": 0.7, "raw": True})):
        expected = expected_motions(model, CAPTIONS[number % 5], seed=number, **options)[0]
        np.testing.assert_array_equal(motion_of(found[number]).codes, expected.codes)
        # Random weights walk hundreds of meters, which float32 rounds to steps of 3e-5.
        atol = max(1e-4, 1e-6 * np.abs(expected.positions).max())
        np.testing.assert_allclose(motion_of(found[number]).positions, expected.positions, atol=atol)


def test_a_chain_says_where_sentences_begin(server, model):
    data = server.motions(*CAPTIONS[:2], seconds=1.0, seed=1)
    (expected,) = model.generate_chain(CAPTIONS[:2], seconds=1.0, seed=1)
    assert data["motions"][0]["part_captions"] == list(CAPTIONS[:2])
    np.testing.assert_allclose(motion_of(data).positions, expected.positions, atol=1e-4)


def test_a_motion_is_changed(server):
    given = server.motions(CAPTIONS[0], seconds=3.0, seed=1)["motions"][0]
    longer = server.motions(CAPTIONS[1], start=given["npz"], seconds=0.8)["motions"][0]
    assert longer["frames"] == given["frames"] + 16
    redone = server.motions(CAPTIONS[1], start=given["npz"], span=[1.0, 2.0], num_samples=2)
    assert [motion["frames"] for motion in redone["motions"]] == [given["frames"]] * 2
    varied = server.motions(CAPTIONS[1], start=given["npz"], strength=0.5)["motions"][0]
    assert varied["frames"] == given["frames"] and varied["npz"] != given["npz"]
    bvh = make_file([decode_base64(given["npz"])], FileOptions(format="bvh"))
    text = base64.b64encode(bvh).decode()
    assert server.motions(CAPTIONS[1], start=text, start_format="bvh", strength=0.3)["motions"][0]["frames"]


def test_an_edit_that_cannot_be_made_fails_with_one_line(server):
    given = server.motions(CAPTIONS[0], seconds=2.0)["motions"][0]["npz"]
    fields = {"captions": [CAPTIONS[0]], "start": given, "span": [5.0, 9.0], "seed": 2}
    name, data = server.ask("POST", "/motions", fields).events[-1]
    assert name == "failed" and data["seed"] == 2 and "span" in data["error"]
    answer = server.ask("POST", "/motions", fields | {"start": "AAAA"})
    assert answer.status == 400 and answer.json["error"].startswith("start: ")


def test_a_request_with_a_key_goes_on_without_its_connection(server):
    key, fields = "k" * 16, {"captions": list(CAPTIONS[:2]), "seconds": 2.0, "seed": 5}
    connection = server.open("POST", f"/motions?keep={key}", fields)
    connection.getresponse().readline()  # it has begun
    connection.close()
    name, data = server.ask("GET", f"/motions/{key}").events[-1]
    assert name == "done" and data["motions"] == server.motions(*CAPTIONS[:2], seconds=2.0, seed=5)["motions"]
    assert server.ask("GET", f"/motions/{key}").events[0][0] == "queued"  # again, from the first event
    assert server.ask("POST", f"/motions?keep={key}", fields).status == 409
    assert server.ask("DELETE", f"/motions/{key}").status == 204
    assert server.ask("GET", f"/motions/{key}").status == 404
    assert server.ask("POST", "/motions?keep=short", fields).status == 400


def test_a_program_may_ask_for_one_answer(server):
    answer = server.ask("POST", "/motions", {"captions": [CAPTIONS[0]]}, {"Accept": "application/json"})
    assert answer.status == 200 and answer.json["motions"][0]["caption"] == CAPTIONS[0]


def test_files_are_made(server):
    npz = decode_base64(server.motions(CAPTIONS[0], seed=5)["motions"][0]["npz"])
    answer = server.ask("POST", "/files?format=glb&names=mixamo", npz)
    assert answer.status == 200 and answer.body[:4] == b"glTF"
    assert answer.headers["content-disposition"] == 'attachment; filename="motion.glb"'
    several = {"motions": [base64.b64encode(npz).decode()] * 2}
    assert server.ask("POST", "/files?format=html", several).body.lower().startswith(b"<!doctype")
    scene = server.ask("POST", "/scene?format=npz&begin=0&end=1&speed=2", npz).json
    assert scene["motion"]["frames"] == 10 and len(scene["scene"]["figures"]) == 1


@pytest.mark.parametrize(
    ("method", "path", "body", "headers", "status"),
    [
        ("POST", "/motions", b"{", {"Content-Type": "application/json"}, 400),
        ("POST", "/motions", b"[" * 100_000, {"Content-Type": "application/json"}, 400),
        ("POST", "/motions", {"captions": []}, {}, 400),
        ("POST", "/motions", b'{"captions": ["a"]}', {"Content-Type": "text/plain"}, 415),
        ("POST", "/motions", {"captions": ["a"]}, {"Origin": "http://evil.example"}, 403),
        ("POST", "/motions", {"captions": ["a"]}, {"Host": "evil.example"}, 400),
        ("GET", "/motions", None, {}, 405),
        ("GET", "/nothing", None, {}, 404),
        ("GET", "/assets/..%2f..%2fapp.py", None, {}, 404),
        ("POST", "/files?format=glb", b"no motion", {}, 400),
        ("POST", "/files?format=exe", b"", {}, 400),
        ("POST", "/files?speed=2&speed=3", b"", {}, 400),
        ("POST", "/motions?kep=0123456789abcdef", {"captions": ["a"]}, {}, 400),
        ("POST", f"/motions?keep={'a' * 16}&keep={'b' * 16}", {"captions": ["a"]}, {}, 400),
        ("POST", "/files", {"motions": "x"}, {}, 400),
        ("POST", "/files", {"motions": ["%"]}, {}, 400),
        ("POST", "/scene?format=amc", b"", {}, 400),
        ("POST", "/character", b"glTF", {}, 415),
        ("POST", "/character", {"character": "Z2xURg=="}, {}, 400),
        ("POST", "/character", {"character": "%", "motions": ["AAAA"]}, {}, 400),
        ("POST", "/character?speed=0", {"character": "AAAA", "motions": ["AAAA"]}, {}, 400),
        ("POST", "/character?rig=../a.yaml", {"character": "AAAA", "motions": ["AAAA"]}, {}, 400),
        ("GET", "/model", None, {"Origin": "null"}, 403),
    ],
)
def test_what_cannot_be_answered_is_refused_in_one_line(server, method, path, body, headers, status):
    answer = server.ask(method, path, body, headers)
    assert answer.status == status
    if answer.headers["content-type"] == "application/json":
        assert "\n" not in answer.json["error"] and "Traceback" not in answer.json["error"]


def test_a_large_body_is_refused_before_it_is_read(server):
    answer = server.ask("POST", "/files?format=glb", b"x" * (MAX_BODY + 2**20))
    assert answer.status == 413
    json_body = {"Content-Type": "application/json"}
    answer = server.ask("POST", "/character", b"x" * (MAX_CHARACTER_BODY + 2**20), json_body)
    assert answer.status == 413


def test_the_page_and_its_parts(server):
    page = server.ask("GET", "/")
    assert page.status == 200 and page.headers["content-type"].startswith("text/html")
    for name in [*page_files(), "stage.css", "viewer.js"]:
        if name != "index.html":
            assert server.ask("GET", f"/assets/{name}").status == 200
    for name, value in HEADERS.items():
        assert page.headers[name.lower()] == value


def test_what_the_server_says_of_itself(server):
    assert server.ask("GET", "/health").json["status"] == "ok"
    model = server.ask("GET", "/model").json
    assert (
        model["fps"] == 20 and "walk" not in model["name"] and model["fields"]["motions"]["num_samples"]["maximum"] == 8
    )
    server.motions(CAPTIONS[0])
    text = server.ask("GET", "/metrics").body.decode()
    assert 't2m_answers_total{result="done"}' in text and "t2m_request_seconds_bucket" in text
    assert {family.name for family in text_string_to_metric_families(text)} >= {"t2m_answers", "t2m_waiting_requests"}


@pytest.mark.parametrize("headers", [{}, {"Accept": "application/json"}])
def test_a_request_ends_when_its_client_leaves(server, headers):
    before = num_answers(server, "cancelled")
    chain = {"captions": [*CAPTIONS] * 4, "seconds": 5.0}
    connections = [server.open("POST", "/motions", chain, headers) for _ in range(3)]
    wait_until(lambda: server.ask("GET", "/health").json["waiting"] == 1)
    for connection in connections:
        connection.sock.shutdown(socket.SHUT_RDWR)
        connection.close()
    wait_until(lambda: num_answers(server, "cancelled") == before + 3)
    assert server.ask("GET", "/health").json["waiting"] == 0


def num_answers(server, result: str) -> float:
    text = server.ask("GET", "/metrics").body.decode()
    values = {name: float(value) for name, value in re.findall(r"^(t2m_answers_total\S+) (\S+)$", text, re.MULTILINE)}
    return values.get(f't2m_answers_total{{result="{result}"}}', 0.0)


def test_hostile_requests_are_answered_and_change_nothing(server):
    before = server.motions("a person walks", seed=3)
    seen, broken = attack(server.port, before["motions"][0]["npz"], seed=0, count=300)
    assert broken == []
    assert seen["400"] > 100 and seen["200"] > 3
    assert server.motions("a person walks", seed=3) == before
    assert "t2m_worker_restarts_total 0" in server.ask("GET", "/metrics").body.decode()


def test_processes_that_calculate_leave_the_processor_to_the_one_that_answers(server):
    file = decode_base64(server.motions(CAPTIONS[0], seed=3)["motions"][0]["npz"])
    for _ in range(2):  # the number of a process grows with each call of `nice`
        assert server.ask("POST", "/scene?format=npz", file).status == 200
    priorities = sorted(os.getpriority(os.PRIO_PROCESS, pid) for pid in processes(server.pid))
    assert priorities[0] == os.nice(0)
    assert priorities[-2:] == [max(os.nice(0), NICENESS)] * 2


def test_a_full_queue_answers_429(server):
    chain = {"captions": [CAPTIONS[0]] * 4, "seconds": 2.0}
    statuses = []

    def ask(_) -> None:
        answer = server.ask("POST", "/motions", chain)
        statuses.append(answer.status)
        if answer.status == 429:
            assert int(answer.headers["retry-after"]) == answer.json["retry_after"] >= 1

    with ThreadPoolExecutor(20) as threads:
        list(threads.map(ask, range(20)))
    assert set(statuses) == {200, 429}


def test_the_process_that_generates_may_die(server):
    command = ["pgrep", "-P", str(server.pid), "-f", "spawn_main"]
    children = [int(pid) for pid in subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()]
    found = []
    asker = threading.Thread(target=lambda: found.append(server.motions(*CAPTIONS * 3, seconds=3.0, seed=1)))
    asker.start()
    wait_until(lambda: "t2m_running_requests 1.0" in server.ask("GET", "/metrics").body.decode())
    for pid in children:
        os.kill(pid, signal.SIGKILL)
    asker.join(120)
    assert found and found[0]["seed"] == 1
    assert "t2m_worker_restarts_total 1.0" in server.ask("GET", "/metrics").body.decode()
    assert server.ask("GET", "/health").json["status"] == "ok"
