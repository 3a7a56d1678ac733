"""Where the data of a training are: on its devices, or on the host, which feeds the devices with windows."""

import contextlib
import logging
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from t2m_jax.data.banks.host import FeedPlan, HostWindows
from t2m_jax.data.banks.motions import FedFrames, banks_of, map_banks, used_rows, without_frames
from t2m_jax.devices import is_true_anywhere
from t2m_jax.errors import UserError
from t2m_jax.memory import device_memory
from t2m_jax.train.config import Placement
from t2m_jax.train.program import Devices

logger = logging.getLogger(__name__)

DEVICE_SHARE = 0.5
"""Largest share of a device's free memory that frames may take with `auto`. The rest is for the computation. On a CPU
it is a share of the memory that this process may use."""


class DataOnDevices:
    """Data that are on the devices as a whole."""

    def __init__(self, data: Any, devices: Devices):
        """Puts the data there."""
        self._data = devices.put_data(data)

    @contextlib.contextmanager
    def feed(self, first_step: int, stop: int, *, size: int = 1) -> Iterator[Callable[[int], Any]]:
        """Yields a function that returns all data for any number of steps."""
        del first_step, stop, size
        yield lambda count: self._data


class DataOnHost:
    """Data whose frames stay on the host; the devices get the windows of some steps at a time."""

    def __init__(self, data: Any, plan: FeedPlan, devices: Devices, *, batch_size: int):
        """Puts everything but the frames on the devices."""
        self._devices = devices
        self._windows = HostWindows(data, plan, rows=devices.rows_of_process(batch_size))
        self._rest = devices.put_data(map_banks(data, without_frames))

    @contextlib.contextmanager
    def feed(self, first_step: int, stop: int, *, size: int = 1) -> Iterator[Callable[[int], Any]]:
        """Yields a function that returns the data of the next steps, given their number, up to `size`.

        The arrays always have room for `size` steps, because programs are compiled for shapes.
        """
        with self._windows.read(first_step, stop, ahead=size) as steps:
            step = first_step

            def take(count: int) -> Any:
                nonlocal step
                windows = [next(steps) for _ in range(count)]
                # Rows that no update reads.
                windows += [windows[-1]] * (size - count)
                fed = FedFrames(np.array(step, np.int32), self._devices.put_windows(np.stack(windows)))
                step += count
                return map_banks(self._rest, lambda bank: bank._replace(frames=fed))

            yield take


def place_data(
    data: Any, plan: FeedPlan | None, devices: Devices, placement: Placement, *, batch_size: int
) -> DataOnDevices | DataOnHost:
    """Returns data where the placement wants them. Data without a plan are small and always on the devices.

    Raises:
        UserError: They are to stay on the host, but `jax.pmap` needs them on the devices.
    """
    if plan is None or placement == "device" or (placement == "auto" and fits_devices(data, devices)):
        return DataOnDevices(data, devices)
    if devices.is_mapped:
        raise UserError(
            "placement: sharding.mode pmap needs the data on the devices, but they are to stay on the host "
            f"({placement}); use --sharding.mode jit, or --placement device if they fit"
        )
    return DataOnHost(data, plan, devices, batch_size=batch_size)


def fits_devices(data: Any, devices: Devices) -> bool:
    """Returns whether the frames of data take at most `DEVICE_SHARE` of the memory of each device of all processes."""
    # Frames are nearly all of the data; each row has as many bytes as the mean.
    needed = sum(used_rows(bank) * bank.mean.nbytes for bank in banks_of(data)) / devices.bank_shares
    free = min(device_memory(device) for device in devices.mesh.local_devices)
    # All processes must choose the same, or they would compile different programs.
    fits = not is_true_anywhere(needed > DEVICE_SHARE * free)
    if not fits:
        sizes = f"{needed / 1e9:.2g} GB for each device, which has {free / 1e9:.2g} GB free"
        logger.info("the motion stays on the host, because it is large (%s); see `placement`", sizes)
    return fits
