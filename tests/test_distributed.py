import contextlib
import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from t2m_jax.cli.main import main
from t2m_jax.distributed import EXIT_LOST, LINGER, START, Processes, find_processes, is_writer, wait_for_all
from t2m_jax.errors import UserError
from t2m_jax.peers import GRACE, Peers

HEARTBEAT, STALL = 5, 8
MARGIN = 12
"""Seconds for the start of Python and for a busy computer."""

MEMBER = """
import os, signal, sys, time
import jax, numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from t2m_jax.distributed import Processes, is_writer, report_progress, supervised, wait_for_all
from t2m_jax.errors import UserError

address, me, what, who = sys.argv[1], int(sys.argv[2]), sys.argv[3], sys.argv[4]
heartbeat, stall = map(int, sys.argv[5:])

def misbehave():
    print("\\nnow", flush=True)
    if what == "kill": os.kill(os.getpid(), signal.SIGKILL)
    if what == "stop": os.kill(os.getpid(), signal.SIGSTOP)
    if what == "hang": time.sleep(1000)
    if what == "fail": raise UserError("step 5: the loss is nan")
    if what == "bug": raise ZeroDivisionError("division by zero")

def train():
    sharding = NamedSharding(Mesh(np.array(jax.devices()), "data"), PartitionSpec("data"))
    values = jax.make_array_from_callback((8, 4), sharding, lambda index: np.ones((8, 4), np.float32)[index])
    update = jax.jit(lambda values: values * 0 + values.mean(), out_shardings=sharding)
    for step in range(10 if what == "finish" else 10**9):
        report_progress()
        values = jax.block_until_ready(update(values))
        if step == 5 and str(me) in who:
            misbehave()
    wait_for_all("trained")
    print("writer" if is_writer() else "reader", flush=True)

jax.config.update("jax_num_cpu_devices", 4)
try:
    with supervised(Processes(address, 2, me, heartbeat=heartbeat, stall=stall)):
        train()
except UserError as error:
    sys.stderr.write(f"t2m: error: {error}\\n")
    sys.exit(2)
"""


class Ended:
    """How a process ended."""

    def __init__(self, process, seconds):
        self.out, self.err = process.communicate(timeout=10)
        self.status, self.seconds = process.returncode, seconds
        self.lines = [line for line in self.err.splitlines() if line.startswith("t2m: error:")]


@pytest.fixture
def address():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{free.getsockname()[1]}"


@contextlib.contextmanager
def started(address, what, who, members=(0, 1)):
    """Starts processes and kills them at the end, also if the test fails."""
    environ = {**os.environ, "TF_CPP_MIN_LOG_LEVEL": "2"}
    processes = {}
    try:
        for me in members:
            command = [sys.executable, "-c", MEMBER, address, str(me), what, who, str(HEARTBEAT), str(STALL)]
            pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
            processes[me] = subprocess.Popen(command, env=environ, text=True, **pipes)
        yield processes
    finally:
        for process in processes.values():
            process.kill()
            process.communicate()


def end_of(process, since, limit):
    process.wait(timeout=limit)
    return Ended(process, time.monotonic() - since)


def event(process):
    """Waits until a process says that it misbehaves now, and returns the time."""
    for line in process.stdout:  # gloo writes there, too
        if line == "now\n":
            return time.monotonic()
    raise AssertionError(process.stderr.read())


def assert_lost(ended, *parts, limit):
    assert ended.status == EXIT_LOST
    assert len(ended.lines) == 1, ended.err
    assert "Traceback" not in ended.err
    for part in parts:
        assert part in ended.lines[0]
    assert ended.seconds < limit


@pytest.mark.slow
@pytest.mark.parametrize(("me", "part"), [(0, "process 1 of 2 did not start"), (1, "the coordinator 127.0.0.1:")])
def test_a_process_does_not_wait_forever_for_one_that_does_not_start(address, me, part):
    start = time.monotonic()
    with started(address, "finish", "", members=[me]) as processes:
        assert_lost(end_of(processes[me], start, 60), part, limit=HEARTBEAT + START + LINGER + MARGIN)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["kill", "stop"])
@pytest.mark.parametrize("bad", [0, 1])
def test_a_dead_or_stopped_process_ends_the_other(address, what, bad):
    with started(address, what, str(bad)) as processes:
        since = event(processes[bad])
        ended = end_of(processes[1 - bad], since, 60)
        assert_lost(ended, f"process {bad}", limit=HEARTBEAT + LINGER + MARGIN)
        if what == "stop":  # if it wakes up, it finds that it is alone
            processes[bad].send_signal(signal.SIGCONT)
            assert_lost(end_of(processes[bad], time.monotonic(), 60), limit=HEARTBEAT + LINGER + MARGIN)


@pytest.mark.slow
def test_a_process_that_hangs_ends_all(address):
    with started(address, "hang", "1") as processes:
        since = event(processes[1])
        for process in processes.values():
            assert_lost(end_of(process, since, 60), "process 1 of 2 is stuck", limit=STALL + LINGER + MARGIN)


@pytest.mark.slow
@pytest.mark.parametrize("bad", [0, 1])
def test_the_error_of_one_process_is_what_the_other_says(address, bad):
    with started(address, "fail", str(bad)) as processes:
        since = event(processes[bad])
        other = end_of(processes[1 - bad], since, 60)
        failed = end_of(processes[bad], since, 60)
    assert_lost(other, f"process {bad} of 2 has ended: step 5: the loss is nan", limit=GRACE + LINGER + MARGIN)
    assert failed.status == 2
    assert failed.err == "t2m: error: step 5: the loss is nan\n"


@pytest.mark.slow
def test_a_bug_of_one_process_ends_the_other(address):
    with started(address, "bug", "1") as processes:
        since = event(processes[1])
        assert_lost(end_of(processes[0], since, 60), "division by zero", limit=GRACE + LINGER + MARGIN)
        assert end_of(processes[1], since, 60).status == 1


@pytest.mark.slow
def test_an_error_of_all_processes_is_a_user_error_of_each(address):
    with started(address, "fail", "01") as processes:
        since = event(processes[0])
        for process in processes.values():
            ended = end_of(process, since, 60)
            assert (ended.status, ended.err) == (2, "t2m: error: step 5: the loss is nan\n")
            assert ended.seconds < LINGER + MARGIN


@pytest.mark.slow
def test_processes_that_finish_say_nothing(address):
    with started(address, "finish", "") as processes:
        ended = [end_of(processes[me], time.monotonic(), 60) for me in (0, 1)]
    assert [one.status for one in ended] == [0, 0]
    assert [one.lines for one in ended] == [[], []]
    assert ["writer" in ended[0].out, "reader" in ended[1].out] == [True, True]


def peers(count=3, stall=20):
    return Peers(process_id=1, num_processes=count, heartbeat=5, stall=stall)


def pass_time(watched, seconds, beat=lambda now: {}, failures=None):
    for now in range(1, seconds + 1):
        watched.wait(1.0)
        beats = beat(now)
        if beats:
            watched.see(beats, failures or {})


def test_peers_that_answer_are_no_problem():
    watched = peers()
    pass_time(watched, 100, lambda now: dict.fromkeys(range(3), f"{now} {now}"))
    assert watched.problem() is None


def test_a_silent_peer_is_named():
    watched = peers()
    pass_time(watched, 6, lambda now: {0: f"{now} {now}", 1: f"{now} {now}"})
    assert "process 2 of 3 has not answered for 5 s" in watched.problem()


def test_only_the_coordinator_is_blamed_for_its_silence():
    watched = peers()
    pass_time(watched, 3, lambda now: dict.fromkeys(range(3), f"{now} {now}"))
    pass_time(watched, 6)
    assert watched.problem().startswith("process 0 of 3 has not answered")


def test_the_process_with_the_least_progress_is_stuck():
    watched = peers()
    pass_time(watched, 25, lambda now: {0: f"{now} 7", 1: f"{now} 7", 2: f"{now} 6"})
    assert watched.problem().startswith("process 2 of 3 is stuck")


def test_one_process_that_makes_progress_is_enough():
    watched = peers()
    pass_time(watched, 100, lambda now: {0: f"{now} {now}", 1: f"{now} 0", 2: f"{now} 0"})
    assert watched.problem() is None


def test_a_stall_of_zero_is_no_limit():
    watched = peers(stall=0)
    pass_time(watched, 100, lambda now: dict.fromkeys(range(3), f"{now} 0"))
    assert watched.problem() is None


def test_the_own_failure_is_no_problem_of_a_peer():
    watched = peers()
    pass_time(watched, 4, lambda now: dict.fromkeys(range(3), f"{now} 0"), {1: "mine"})
    assert watched.problem() is None


def test_torchrun_is_understood():
    environ = {"MASTER_ADDR": "node1", "MASTER_PORT": "29500", "WORLD_SIZE": "4", "RANK": "2"}
    assert find_processes(environ) == Processes("node1:29500", 4, 2)
    elastic = {**environ, "TORCHELASTIC_USE_AGENT_STORE": "True", "LOCAL_RANK": "1", "LOCAL_WORLD_SIZE": "2"}
    assert find_processes(elastic, heartbeat=9) == Processes("node1:29501", 4, 2, (1,), 9)


def test_other_clusters_are_left_to_jax():
    assert find_processes({"MASTER_ADDR": "node1", "SLURM_PROCID": "0"}) == Processes()


def test_a_variable_that_is_not_a_number_is_named():
    with pytest.raises(UserError, match=r"WORLD_SIZE.*'two'"):
        find_processes({"MASTER_ADDR": "a", "MASTER_PORT": "1", "WORLD_SIZE": "two", "RANK": "0"})


def test_one_process_writes_and_waits_for_nobody():
    assert is_writer()
    wait_for_all("anything")


@pytest.mark.parametrize(
    "options",
    [
        ["--coordinator", "localhost:1"],
        ["--coordinator", "localhost:1", "--num-processes", "2", "--process-id", "2"],
        ["--coordinator", "localhost", "--num-processes", "2", "--process-id", "0"],
        ["--distributed", "--coordinator", "localhost:1", "--num-processes", "2", "--process-id", "0"],
        ["--heartbeat", "20"],
        ["--distributed", "--heartbeat", "1"],
        ["--distributed", "--stall", "-1"],
    ],
)
def test_options_that_do_not_fit_are_refused(options, tmp_path, capsys):
    run = ["--run", str(tmp_path / "run"), "--data", str(tmp_path)]
    assert main(["train", "vqvae", "official", *run, *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("t2m: error: train: ")


@pytest.mark.slow
def test_the_command_says_that_the_coordinator_does_not_answer(address, tmp_path):
    command = [sys.executable, "-m", "t2m_jax.cli", "train", "vqvae", "official", "--run", str(tmp_path / "run")]
    options = ["--data", str(tmp_path), "--coordinator", address, "--num-processes", "2", "--process-id", "1"]
    result = subprocess.run([*command, *options, "--heartbeat", "5"], capture_output=True, text=True, timeout=60)
    assert result.returncode == EXIT_LOST
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"t2m: error: the coordinator {address} did not answer")


@pytest.mark.slow
def test_the_command_says_that_there_is_no_cluster(tmp_path):
    command = [sys.executable, "-m", "t2m_jax.cli", "train", "vqvae", "official", "--run", str(tmp_path / "run")]
    result = subprocess.run([*command, "--distributed"], capture_output=True, text=True, timeout=60)
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert line.startswith("t2m: error: --distributed: found no cluster")
