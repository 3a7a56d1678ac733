import contextlib
import socket
import subprocess
import sys
import time

import pytest

from t2m_jax.cli.main import main
from t2m_jax.distributed import START, Processes, find_processes, is_writer, wait_for_all
from t2m_jax.errors import UserError

HEARTBEAT = 8
MARGIN = 30
"""Seconds for the start of Python and for a busy computer."""

MEMBER = """
import os, signal, sys, time
import jax, numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from t2m_jax.distributed import Processes, connected, is_writer, wait_for_all
from t2m_jax.errors import UserError

address, me, what, who, heartbeat = sys.argv[1], int(sys.argv[2]), sys.argv[3], sys.argv[4], int(sys.argv[5])

def misbehave():
    print("\\nnow", flush=True)
    if what == "kill": os.kill(os.getpid(), signal.SIGKILL)
    if what == "stop": os.kill(os.getpid(), signal.SIGSTOP)
    if what == "fail": raise UserError("step 5: the loss is nan")

def train():
    sharding = NamedSharding(Mesh(np.array(jax.devices()), "data"), PartitionSpec("data"))
    values = jax.make_array_from_callback((8, 4), sharding, lambda index: np.ones((8, 4), np.float32)[index])
    update = jax.jit(lambda values: values * 0 + values.mean(), out_shardings=sharding)
    for step in range(10 if what == "finish" else 10**9):
        values = jax.block_until_ready(update(values))
        if step == 5 and str(me) in who:
            misbehave()
    if is_writer():
        time.sleep(heartbeat + 2)  # as in an evaluation, for which the others wait
    wait_for_all("trained")
    print("writer" if is_writer() else "reader", flush=True)

jax.config.update("jax_num_cpu_devices", 4)
try:
    with connected(Processes(address, 2, me, heartbeat=heartbeat)):
        train()
except UserError as error:
    sys.stderr.write(f"t2m: error: {error}\\n")
    sys.exit(2)
"""


def free_address():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{free.getsockname()[1]}"


@contextlib.contextmanager
def started(what, who, members=(0, 1)):
    """Starts processes and kills them at the end, also if the test fails."""
    address, processes = free_address(), {}
    try:
        for me in members:
            command = [sys.executable, "-c", MEMBER, address, str(me), what, who, str(HEARTBEAT)]
            processes[me] = subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        yield processes
    finally:
        for process in processes.values():
            process.kill()
            process.communicate()


def event(process):
    """Waits until a process says that it misbehaves now."""
    for line in process.stdout:  # gloo writes there, too
        if line == "now\n":
            return
    raise AssertionError(process.stderr.read())


# These tests look at both cases at once, because most of the time their processes wait.
@pytest.mark.slow
@pytest.mark.release
def test_a_process_does_not_wait_forever_for_one_that_does_not_start():
    with started("finish", "", members=[0]) as first, started("finish", "", members=[1]) as second:
        end = time.monotonic() + HEARTBEAT + START + MARGIN
        for process in (first[0], second[1]):
            assert process.wait(timeout=end - time.monotonic()) != 0


@pytest.mark.slow
@pytest.mark.parametrize("what", ["kill", pytest.param("stop", marks=pytest.mark.release)])
def test_a_dead_or_stopped_process_ends_the_other(what):
    with started(what, "0") as one, started(what, "1") as other:
        event(one[0])
        event(other[1])
        end = time.monotonic() + 2 * HEARTBEAT + MARGIN
        for bad, processes in enumerate((one, other)):
            assert processes[1 - bad].wait(timeout=end - time.monotonic()) != 0


@pytest.mark.slow
def test_the_error_of_one_process_is_shown_and_ends_the_other():
    with started("fail", "0") as one, started("fail", "1") as other:
        event(one[0])
        event(other[1])
        end = time.monotonic() + 2 * HEARTBEAT + MARGIN
        for bad, processes in enumerate((one, other)):
            assert processes[1 - bad].wait(timeout=end - time.monotonic()) != 0
            assert processes[bad].wait(timeout=MARGIN) != 0
            assert "t2m: error: step 5: the loss is nan\n" in processes[bad].stderr.read()


@pytest.mark.slow
def test_processes_that_finish_wait_for_each_other_and_say_nothing():
    with started("finish", "") as processes:
        ended = [processes[me].communicate(timeout=HEARTBEAT + MARGIN) for me in (0, 1)]
        assert [processes[me].returncode for me in (0, 1)] == [0, 0], ended
    assert ["writer" in ended[0][0], "reader" in ended[1][0]] == [True, True]
    assert "error" not in ended[0][1] + ended[1][1]


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
    ],
)
def test_options_that_do_not_fit_are_refused(options, tmp_path, capsys):
    run = ["--run", str(tmp_path / "run"), "--data", str(tmp_path)]
    assert main(["train", "vqvae", "official", *run, *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("t2m: error: train: ")


@pytest.mark.slow
@pytest.mark.release
def test_the_command_ends_if_the_coordinator_does_not_answer(tmp_path):
    address = free_address()
    command = [sys.executable, "-m", "t2m_jax", "train", "vqvae", "official", "--run", str(tmp_path / "run")]
    options = ["--data", str(tmp_path), "--coordinator", address, "--num-processes", "2", "--process-id", "1"]
    result = subprocess.run([*command, *options, "--heartbeat", "5"], capture_output=True, text=True, timeout=60)
    assert result.returncode != 0 and address.rpartition(":")[2] in result.stderr


@pytest.mark.slow
@pytest.mark.release
def test_the_command_says_that_there_is_no_cluster(tmp_path):
    command = [sys.executable, "-m", "t2m_jax", "train", "vqvae", "official", "--run", str(tmp_path / "run")]
    result = subprocess.run([*command, "--distributed"], capture_output=True, text=True, timeout=60)
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert line.startswith("t2m: error: --distributed: found no cluster")
