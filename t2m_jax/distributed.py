"""Several processes that train together: they start, watch each other and end together.

JAX starts the processes and sends its own heartbeats, but it does not notice a process whose main thread hangs, it ends
the others with a C++ stack trace, and after an exception in one process the others wait forever. So a thread in each
process writes a beat every second to the key-value store of JAX's coordinator (process 0) and reads those of the
others. If one is missing for `heartbeat` seconds, each process writes one line and exits. JAX's own heartbeat has a
longer limit and is the reserve. With one process, nothing here starts a thread or opens a port.
"""

import atexit
import contextlib
import ctypes
import itertools
import os
import re
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from t2m_jax.errors import UserError
from t2m_jax.peers import GRACE, Peers

EXIT_LOST = 3
"""Exit status of a process that ends because another one is missing, dead or stuck."""
HEARTBEAT = 30
"""Seconds without a beat after which a process counts as dead or stuck."""
STALL = 1800
"""Seconds without progress of any process after which one of them counts as stuck; 0 never.

Compiling, evaluating or rendering may legitimately take minutes, and the main thread cannot report progress meanwhile.
"""
POLL = 1.0
"""Seconds between two beats."""
LINGER = 5.0
"""Seconds that process 0 waits before it exits on failure: longer than `POLL + GRACE`, so that others can read why."""
START = 10
"""Seconds by which processes may start later than others, beyond the heartbeat."""
BEATS, FAILURES = "t2m/beats/", "t2m/failures/"
CONNECTION_ERRORS = re.compile(
    r"gloo|nccl|UNAVAILABLE|DEADLINE_EXCEEDED|closed by peer|connection (reset|refused)", re.I
)
"""What errors of collectives say if another process is the cause."""


class Processes(NamedTuple):
    """The processes of one run; without a coordinator, JAX asks the cluster (Slurm, Open MPI, TPU)."""

    coordinator: str | None = None
    """`HOST:PORT` of process 0."""
    num_processes: int | None = None
    process_id: int | None = None
    local_device_ids: tuple[int, ...] | None = None
    """Devices of this host that the process uses, None for all (or for what the cluster says)."""
    heartbeat: int = HEARTBEAT
    stall: int = STALL


def find_processes(environ: Mapping[str, str], *, heartbeat: int = HEARTBEAT, stall: int = STALL) -> Processes:
    """Returns the processes that the variables of torchrun describe or, without them, those that JAX will find.

    Raises:
        UserError: A variable is not a number.
    """
    if not {"MASTER_ADDR", "MASTER_PORT", "WORLD_SIZE", "RANK"} <= environ.keys():
        return Processes(heartbeat=heartbeat, stall=stall)
    try:
        port, count, rank = (int(environ[name]) for name in ("MASTER_PORT", "WORLD_SIZE", "RANK"))
        local, local_count = int(environ.get("LOCAL_RANK", "0")), int(environ.get("LOCAL_WORLD_SIZE", "1"))
    except ValueError as error:
        raise UserError(f"MASTER_PORT, WORLD_SIZE, RANK or LOCAL_RANK: not a number ({error})") from error
    # torchrun itself listens at MASTER_PORT.
    port += environ.get("TORCHELASTIC_USE_AGENT_STORE") == "True"
    devices = (local,) if local_count > 1 else None
    return Processes(f"{environ['MASTER_ADDR']}:{port}", count, rank, devices, heartbeat, stall)


class _Progress:
    """Counts what the main thread has done."""

    count = 0


# All are one per process, like the state of jax.distributed, so that the training loop needs no handle.
_PROGRESS = _Progress()
_BARRIERS = itertools.count()
_LAST_WORD = threading.Lock()
"""Whoever has it says why the process ends. It is never released."""


def report_progress() -> None:
    """Says that the main thread is not stuck; called before every update and every batch of a measurement.

    Called before the work, it shows which process is stuck: the others have reported once more, and wait for it.
    """
    _PROGRESS.count += 1


def is_writer() -> bool:
    """Returns whether this process writes files and logs: only process 0 does."""
    import jax

    return not jax.distributed.is_initialized() or jax.process_index() == 0


def wait_for_all(name: str) -> None:
    """Returns when all processes have called it."""
    import jax

    if jax.distributed.is_initialized():
        # The watch ends a process that waits in vain, so the barrier needs no limit.
        _client().wait_at_barrier(f"t2m/{next(_BARRIERS)}/{name}", 10**9)


@contextlib.contextmanager
def supervised(processes: Processes | None) -> Iterator[None]:
    """Starts the processes, watches them and ends them together; None is one process, for which it does nothing.

    If another process is missing, dead or stuck, this process writes one line and exits with `EXIT_LOST`. An error in
    the block is raised again, after the other processes were told.

    Raises:
        UserError: The processes cannot start, or a connection between them is lost for an unknown reason.
    """
    if processes is None:
        yield
        return
    start_processes(processes)
    watch = _Watch(processes)
    watch.start()
    try:
        yield
        wait_for_all("end")
    except BaseException as error:
        failure = error
        if _is_connection_error(error):  # The watch will know which process it is, and exit.
            time.sleep(processes.heartbeat + GRACE + 2 * POLL)
            failure = UserError(f"the connection to another process is lost: {error}")
        watch.fail(failure)
        _skip_shutdown(failure)
        if failure is error:
            raise
        raise failure from error
    watch.end()
    import jax

    jax.distributed.shutdown()
    _handle_abort(None)


def start_processes(processes: Processes) -> None:
    """Connects this process with the others; called before the first use of a device.

    If the coordinator or another process is missing, the process writes one line and exits with `EXIT_LOST`.

    Raises:
        UserError: No cluster is found, or the coordinator's address cannot be used.
    """
    import jax

    jax.config.update("jax_enable_preemption_service", True)  # SIGTERM ends the training after the same step in all
    limit = processes.heartbeat + START
    # JAX ends the process with a stack trace if a process is missing, so a timer comes first.
    timer = threading.Timer(limit, lambda: _exit(_missing(processes, limit), after=_linger(processes.process_id)))
    timer.daemon = True
    timer.start()
    # JAX beats twice per limit, so it may notice a dead process after half of it. This module should be first.
    reserve = 2 * (processes.heartbeat + START)
    _handle_abort(_explain_abort)
    try:
        jax.distributed.initialize(
            processes.coordinator,
            processes.num_processes,
            processes.process_id,
            local_device_ids=processes.local_device_ids,
            initialization_timeout=limit + 60,
            heartbeat_timeout_seconds=reserve,
        )
    except (ValueError, RuntimeError) as error:
        if processes.coordinator is None:
            raise UserError(
                f"--distributed: found no cluster ({error}); give --coordinator, --num-processes and --process-id"
            ) from error
        raise UserError(f"{processes.coordinator}: cannot start process {processes.process_id}: {error}") from error
    finally:
        timer.cancel()


def _handle_abort(handler: Any) -> None:
    """Sets the handler of SIGABRT; None stands for the system's. On Windows, an abort shows what JAX says of it."""
    # A handler of Python's `signal` module would run too late: `abort` ends the process when the C handler returns.
    if os.name == "posix":
        ctypes.CDLL(None).signal(int(signal.SIGABRT), handler)


def _missing(processes: Processes, seconds: int) -> str:
    """Returns what to say if not all processes have connected in time."""
    place = "" if processes.coordinator is None else f" {processes.coordinator}"
    if processes.process_id != 0 and place and not _answers(place.strip()):
        return f"the coordinator{place} did not answer for {seconds} s; start process 0 there, and check the firewall"
    others = "process 1" if (processes.process_id, processes.num_processes) == (0, 2) else "another process"
    count = "" if processes.num_processes is None else f" of {processes.num_processes}"
    return (
        f"{others}{count} did not start within {seconds} s; start all processes with the same coordinator{place} and "
        "different process ids"
    )


def _answers(address: str) -> bool:
    """Returns whether a program listens at `HOST:PORT`."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=2).close()
    except (OSError, ValueError):
        return False
    return True


class _Watch:
    """The threads that watch the other processes."""

    def __init__(self, processes: Processes):
        import jax

        self._client, self._me = _client(), jax.process_index()
        self._peers = Peers(
            process_id=self._me,
            num_processes=jax.process_count(),
            heartbeat=processes.heartbeat,
            stall=processes.stall,
        )
        self._over = threading.Event()
        # A request to a coordinator that is stuck does not return, so time is counted in another thread.
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._exchange_beats, self._count_time)]

    def start(self) -> None:
        """Starts to watch."""
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        """Ends the watch, so that the processes can disconnect."""
        self._over.set()
        for thread in self._threads:
            thread.join()

    def fail(self, error: BaseException) -> None:
        """Ends the watch and tells the other processes why this one ends."""
        _LAST_WORD.acquire()  # waits for the end of the process if the watch is about to end it
        self._over.set()
        with contextlib.suppress(RuntimeError):
            self._client.key_value_set(f"{FAILURES}{self._me}", str(error) or type(error).__name__)
            time.sleep(_linger(self._me))

    def _exchange_beats(self) -> None:
        for beat in range(sys.maxsize):
            with contextlib.suppress(RuntimeError):  # without an answer, `Peers` counts the seconds
                self._client.key_value_set(f"{BEATS}{self._me}", f"{beat} {_PROGRESS.count}", allow_overwrite=True)
                self._peers.see(self._read(BEATS), self._read(FAILURES))
            if self._over.wait(POLL):
                return

    def _read(self, folder: str) -> dict[int, str]:
        found = self._client.key_value_dir_get(folder)
        return {int(key.rpartition("/")[2]): value for key, value in found}

    def _count_time(self) -> None:
        while not self._over.wait(POLL):
            self._peers.wait(POLL)
            problem = self._peers.problem()
            if problem is not None:
                _exit(problem, after=_linger(self._me))


@ctypes.CFUNCTYPE(None, ctypes.c_int)
def _explain_abort(_: int) -> None:
    """Handles SIGABRT: JAX aborts at once if the connection to the coordinator breaks."""
    from jax._src import distributed

    state = distributed.global_state
    address = state.coordinator_address
    dead = state.process_id != 0 and address is not None and not _answers(address)
    which = "process 0 (the coordinator)" if dead else "another process"
    _exit(f"{which} has ended or does not answer; see its log, then start all processes again with --resume")
    os._exit(EXIT_LOST)  # the watch writes its own line


def _linger(process_id: int | None) -> float:
    """Returns the seconds before a failed process exits."""
    return LINGER if process_id == 0 else 0.0


def _is_connection_error(error: BaseException) -> bool:
    """Returns whether an error of JAX says that another process is the cause."""
    import jax

    return isinstance(error, jax.errors.JaxRuntimeError) and CONNECTION_ERRORS.search(str(error)) is not None


def _skip_shutdown(error: BaseException) -> None:
    """Makes the program exit without JAX's shutdown, which would wait for the other processes for minutes."""
    number = getattr(error, "number", signal.SIGINT)
    code = 128 + number if isinstance(error, KeyboardInterrupt) else 2 if isinstance(error, UserError | OSError) else 1

    def leave() -> None:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)

    atexit.register(leave)  # runs before JAX's own, which was registered earlier


def _exit(problem: str, *, after: float = 0.0) -> None:
    """Writes one line and ends the process, whatever its main thread does; returns if it is ending already."""
    if not _LAST_WORD.acquire(blocking=False):
        return
    start = "\n" if sys.stderr.isatty() else ""  # a progress bar may be in the line
    os.write(2, f"{start}t2m: error: {' '.join(problem.split())}\n".encode())
    time.sleep(after)
    os._exit(EXIT_LOST)


def _client() -> Any:
    """Returns the client of the coordinator; JAX has no public way to its key-value store and barriers."""
    from jax._src import distributed

    return distributed.global_state.client
