"""The kernels: files with arithmetic on scans and near points, which Cython compiles.

A kernel's file is the only source of its arithmetic. `setup.py` makes of `barrier.py` the library
`_barrier.abi3.so` beside it, together with the files that PARTS of setup.py names. CPython runs the
files themselves where there is no library, where the environment has SWARMD_COMPILED=0, and where a
library was compiled from another version of its sources: the code around it may call what it lacks.
All libraries import `_views.abi3.so`, which holds Cython's code for views of memory. Where `_views`
is absent or was compiled by another version of Cython, CPython runs the files, too.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import struct
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

KERNELS = (
    "swarmd.kit.points",
    "swarmd.protection.arbiter",
    "swarmd.protection.assumption_monitor",
    "swarmd.protection.barrier",
    "swarmd.protection.blind_zone",
    "swarmd.protection.following",
    "swarmd.protection.openings",
    "swarmd.protection.tracks",
    "swarmd.protection.velocity_obstacles",
    "swarmd.robot.tick",
    "swarmd.sensing.scans",
    "swarmd.sim.world.base",
    "swarmd.sim.world.ray_caster",
)

VIEWS = "swarmd.core.views"
"""Names the library `_views` as KERNELS name theirs; no file `views.py` exists."""

_NOT_COMPILED = "not compiled"
_STALE = "older than its source (run make kernels)"


def load_kernel(name: str) -> Any:
    """The kernel whose file is the module of this name: compiled, or else interpreted.

    One line in the log tells of a kernel that is older than its source. To import the module by its
    name always gives the interpreted one.
    """
    return _compiled(name) or import_module(name)


def describe_kernels() -> str:
    """`compiled`, or `interpreted` and why; it imports no kernel."""
    if not _is_wanted():
        return "interpreted (SWARMD_COMPILED=0)"
    faults = {name: fault for name in KERNELS if (fault := _fault_of(name))}
    if not faults:
        return "compiled"
    if len(faults) == len(KERNELS):
        return f"interpreted ({', '.join(dict.fromkeys(faults.values()))})"
    return (
        f"compiled, but {', '.join(f'{_short(name)} is {fault}' for name, fault in faults.items())}"
    )


def _compiled(name: str) -> Any:
    """The library of a kernel; None where the file is to be interpreted."""
    if not _is_wanted() or _fault_of(name):
        return None
    try:
        return import_module(_library_name(name))
    except ImportError:  # built for another processor
        return None


def _is_wanted() -> bool:
    return os.environ.get("SWARMD_COMPILED", "1") != "0"


@cache
def _fault_of(name: str) -> str:
    """Why a kernel cannot be used, empty if it can; its library is opened, but not imported."""
    path, library, views = _library(name), _opened(name), _opened(VIEWS)
    if path is None or library is None or views is None:
        return _NOT_COMPILED
    is_stale = _text_in(library, "views_digest") != _text_in(views, "views_digest")
    if path.with_name(f"{_short(name)}.py").exists():
        sources = [path.with_name(file) for file in _text_in(library, "source_names").split()]
        content = b"".join(file.read_bytes() for file in sources if file.exists())
        is_stale |= _text_in(library, "source_digest") != hashlib.sha256(content).hexdigest()
    if is_stale:
        import logging  # rarely needed, and swarmctl starts fast

        logging.getLogger(__name__).warning("kernel %s is %s", _short(name), _STALE)
        return _STALE
    return ""


@cache
def _opened(name: str) -> ctypes.CDLL | None:
    path = _library(name)
    try:
        return None if path is None else ctypes.CDLL(str(path))
    except OSError:  # damaged, or built for another processor
        return None


def _text_in(library: ctypes.CDLL, name: str) -> str:
    """The text `name` that setup.py put into a library; empty without one."""
    try:
        return ctypes.string_at(ctypes.addressof(ctypes.c_char.in_dll(library, name))).decode()
    except ValueError:
        return ""


def _short(name: str) -> str:
    return name.rpartition(".")[2]


def _library_name(name: str) -> str:
    package, _, file = name.rpartition(".")
    return f"{package}._{file}" if package else f"_{file}"


def _library(name: str) -> Path | None:
    """The compiled file of a kernel; None if it was not built or is not whole.

    To load a file that was cut off may end the process with SIGBUS. An ELF file ends with its table
    of sections; its header says where the table is.
    """
    spec = find_spec(_library_name(name))
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
