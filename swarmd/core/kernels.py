"""The compiled kernels: arithmetic on scans and near points, in C.

The numpy code does the same and stays the reference. It runs where the kernels were not built, and
where the environment has SWARMD_COMPILED=0.
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

KERNELS = (
    "swarmd.protection.barrier_kernel",
    "swarmd.protection.blind_zone_kernel",
    "swarmd.sensing.scan_kernel",
    "swarmd.sim.world.base_kernel",
    "swarmd.sim.world.lidar_kernel",
)


def load_kernel(name: str) -> Any:
    """The kernel of this module name; None where the numpy code runs instead."""
    if not _is_wanted() or (name not in sys.modules and _library(name) is None):
        return None
    try:
        return import_module(name)
    except ImportError:  # built for another processor
        return None


def describe_kernels() -> str:
    """`compiled`, or `numpy` and why; it imports no kernel."""
    if not _is_wanted():
        return "numpy (SWARMD_COMPILED=0)"
    names = {name: name.rpartition(".")[2].removesuffix("_kernel") for name in KERNELS}
    missing = [short for name, short in names.items() if not _is_built(name)]
    if not missing:
        return "compiled"
    is_all = len(missing) == len(KERNELS)
    return "numpy (not compiled)" if is_all else f"compiled, but not {', '.join(missing)}"


def _is_wanted() -> bool:
    return os.environ.get("SWARMD_COMPILED", "1") != "0"


def _is_built(name: str) -> bool:
    """True if the kernel can be loaded; the library is tried, but not imported."""
    library = _library(name)
    if library is None:
        return False
    try:
        ctypes.CDLL(str(library))
    except OSError:  # damaged, or built for another processor
        return False
    return True


def _library(name: str) -> Path | None:
    """The compiled file of a kernel; None if it was not built or is not whole.

    To load a file that was cut off may end the process with SIGBUS. An ELF file ends with its table
    of sections; its header says where the table is.
    """
    spec = find_spec(name)
    if spec is None or spec.origin is None or not spec.origin.endswith(".so"):
        return None
    library = Path(spec.origin)
    with library.open("rb") as file:
        header = file.read(64)
    if header[:5] == b"\x7fELF\x02":
        if len(header) < 64:
            return None
        order = "<" if header[5] == 1 else ">"
        (table,) = struct.unpack_from(order + "Q", header, 40)
        size, count = struct.unpack_from(order + "HH", header, 58)
        if library.stat().st_size < table + size * count:
            return None
    return library
