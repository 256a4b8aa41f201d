"""The compiled kernels: arithmetic on scans and near points, in C.

The numpy code does the same and stays the reference. It runs where the kernels were not built, and
where the environment has SWARMD_COMPILED=0.
"""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import find_spec
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
    if not _is_wanted():
        return None
    try:
        return import_module(name)
    except ImportError:  # not built, or built for another processor
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
    spec = find_spec(name)
    return spec is not None and spec.origin is not None and spec.origin.endswith(".so")
