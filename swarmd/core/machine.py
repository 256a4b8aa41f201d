"""Facts of the machine that this process runs on, from the kernel; no other program is started."""

from __future__ import annotations

import ctypes
import os
import platform
import shutil
import socket
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from swarmd.core.files import write_fault
from swarmd.core.verbs import DiskFacts, MachineFacts

_ADJTIMEX_BYTES = 512  # of struct timex, with room to spare
_TIME_ERROR = 5  # adjtimex(2): the clock is not synchronised
_DEVICES = Path("/sys/devices/platform")


def measure_machine(folders: Iterable[tuple[str, Path]]) -> MachineFacts:
    """Measure the machine. `folders`: (purpose, folder) of its disks. May wait for a disk."""
    memory = _memory()
    return MachineFacts(
        host=socket.gethostname()[:64],
        python=platform.python_version(),
        cores=os.cpu_count() or 1,
        load=os.getloadavg()[0],
        memory=memory.get("MemTotal", 0),
        free_memory=memory.get("MemAvailable", 0),
        wall=time.time(),
        is_synced=is_clock_synced(),
        disks=tuple(_disk(purpose, folder) for purpose, folder in folders),
        throttled=throttled(),
    )


def throttled(devices: Path = _DEVICES) -> int | None:
    """The bits by which the firmware of a Raspberry Pi reports low voltage; None elsewhere.

    `devices`: the folder of the platform devices in sysfs.
    """
    for file in devices.glob("soc*/*firmware/get_throttled"):
        with suppress(OSError, ValueError):
            return int(file.read_text(), 16)
    return None


def is_clock_synced() -> bool | None:
    """Whether the kernel considers the wall clock synchronised (adjtimex); None if unknown."""
    buffer = ctypes.create_string_buffer(_ADJTIMEX_BYTES)  # modes 0: reads and sets nothing
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(buffer)
    except (OSError, AttributeError):
        return None
    return None if state < 0 else state != _TIME_ERROR


def _disk(purpose: str, folder: Path) -> DiskFacts:
    fault = write_fault(folder)
    free = 0
    size = 0
    with suppress(OSError, StopIteration):
        there = next(path for path in (folder, *folder.parents) if path.exists())
        usage = shutil.disk_usage(there)
        free = usage.free
        size = usage.total
    return DiskFacts(purpose=purpose, path=str(folder)[:1000], free=free, size=size, fault=fault)


def _memory() -> dict[str, int]:
    sizes = {}
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text().splitlines()[:8]:
            name, _, rest = line.partition(":")
            sizes[name] = int(rest.split()[0]) * 1024
    return sizes
