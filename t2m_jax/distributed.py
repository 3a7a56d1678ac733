"""Several processes that train together: they start, wait for each other, and one of them writes.

JAX's coordination service, which runs in process 0, watches the processes: if one of them has sent no heartbeat for
`heartbeat` seconds, or has ended with an error, it ends the others. A launcher (Slurm, torchrun, Kubernetes) starts all
of them again with `--resume`. With one process, nothing here opens a port.
"""

import contextlib
import itertools
import logging
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from t2m_jax.errors import UserError

logger = logging.getLogger(__name__)

HEARTBEAT = 30
"""Seconds without a heartbeat after which a process counts as dead."""
START = 10
"""Seconds by which processes may start later than others, beyond the heartbeat."""
WITHOUT_LIMIT = 2**31 - 1
"""Milliseconds, 24 days: process 0 may evaluate for hours while the others wait. Heartbeats find dead ones."""


class Processes(NamedTuple):
    """The processes of one run; without a coordinator, JAX asks the cluster (Slurm, Open MPI, TPU)."""

    coordinator: str | None = None
    """`HOST:PORT` of process 0."""
    num_processes: int | None = None
    process_id: int | None = None
    local_device_ids: tuple[int, ...] | None = None
    """Devices of this host that the process uses, None for all (or for what the cluster says)."""
    heartbeat: int = HEARTBEAT


def find_processes(environ: Mapping[str, str], *, heartbeat: int = HEARTBEAT) -> Processes:
    """Returns the processes that the variables of torchrun describe or, without them, those that JAX will find.

    Raises:
        UserError: A variable is not a number.
    """
    if not {"MASTER_ADDR", "MASTER_PORT", "WORLD_SIZE", "RANK"} <= environ.keys():
        return Processes(heartbeat=heartbeat)
    try:
        port, count, rank = (int(environ[name]) for name in ("MASTER_PORT", "WORLD_SIZE", "RANK"))
        local, local_count = int(environ.get("LOCAL_RANK", "0")), int(environ.get("LOCAL_WORLD_SIZE", "1"))
    except ValueError as error:
        raise UserError(f"MASTER_PORT, WORLD_SIZE, RANK or LOCAL_RANK: not a number ({error})") from error
    # torchrun itself listens at MASTER_PORT.
    port += environ.get("TORCHELASTIC_USE_AGENT_STORE") == "True"
    devices = (local,) if local_count > 1 else None
    return Processes(f"{environ['MASTER_ADDR']}:{port}", count, rank, devices, heartbeat)


# Like the state of jax.distributed, there is one per process. All processes count alike, so the keys are unique.
_BARRIERS = itertools.count()


def is_writer() -> bool:
    """Returns whether this process writes files and logs: only process 0 does."""
    import jax

    return not jax.distributed.is_initialized() or jax.process_index() == 0


def wait_for_all(name: str) -> None:
    """Returns when all processes have called it."""
    import jax

    if jax.distributed.is_initialized():
        # A barrier of the coordinator. `jax.experimental.multihost_utils` has one of the devices, which on CPUs fails
        # after 30 s.
        from orbax.checkpoint import multihost

        multihost.get_barrier_sync_fn()(key=f"t2m/{next(_BARRIERS)}/{name}", timeout_ms=WITHOUT_LIMIT)


@contextlib.contextmanager
def connected(processes: Processes) -> Iterator[None]:
    """Connects this process with the others, and waits for them at the end; called before the first use of a device.

    After an error in the block, JAX waits for the others for `heartbeat` seconds and then aborts all of them.

    Raises:
        UserError: No cluster is found, or the coordinator's address cannot be used.
    """
    import jax

    # If another process is missing, JAX aborts this one with a log that does not say where it has waited.
    if processes.coordinator is not None:
        logger.info("process %s: waiting for the others at %s", processes.process_id, processes.coordinator)
    jax.config.update("jax_enable_preemption_service", True)  # SIGTERM ends the training after the same step in all
    try:
        jax.distributed.initialize(
            processes.coordinator,
            processes.num_processes,
            processes.process_id,
            local_device_ids=processes.local_device_ids,
            initialization_timeout=processes.heartbeat + START,
            heartbeat_timeout_seconds=processes.heartbeat,
            shutdown_timeout_seconds=processes.heartbeat,
        )
    except (ValueError, RuntimeError) as error:
        if processes.coordinator is None:
            raise UserError(
                f"--distributed: found no cluster ({error}); give --coordinator, --num-processes and --process-id"
            ) from error
        raise UserError(f"{processes.coordinator}: cannot start process {processes.process_id}: {error}") from error
    yield
    wait_for_all("end")
    jax.distributed.shutdown()
