"""The kernels: files with arithmetic on scans and near points, which Cython compiles.

A kernel's file is the only source of its arithmetic. `setup.py` compiles the kernels of each row of
LIBRARIES into one library. Kernels that call each other's functions of C are in one row: from one
library to another, a call with nine arrays takes 8 us. So a kernel that many use is in many rows,
and each of these libraries holds its own copy of the code.

CPython interprets the files if

- there is no library,
- the environment has SWARMD_COMPILED=0,
- a library was compiled from other sources than the present files: callers might use functions that
  the library lacks,
- the library `_views` is absent or was compiled by another version of Cython. All libraries import
  it, since it contains Cython's code for memory views.

setup.py runs this file alone, so this file imports no other module of swarmd.

Reasons and measurements:

- There are several libraries since these compile in parallel. Their price: even the cheapest call
  from one library to another costs 50 ns. All these calls take an estimated 2 % of the time with
  100 robots.
- A kernel's function without a result has the type `cython.int` and no `return` at its end, where
  Cython returns 0. Cython passes an exception by the value -1, so its caller need not ask for an
  exception after each call.
- To compile classes of Python as they are gained nothing. The gain comes from C fields, buffers of
  doubles and fewer calls.
- Time of an event (a scan or a decision) in mode barrier, in recorded runs: 1.01 ms by a version in
  numpy, 0.71 ms by this source interpreted, 0.07 ms compiled.
- A run of seven robots in lockstep took, interpreted, 1.1 to 1.35 times the time of numpy.
- numba was refused: it adds 117 MB to a daemon.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import struct
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any

LIBRARIES: Mapping[str, tuple[str, ...]] = {
    "swarmd.protection._barrier": (
        "swarmd.core.angles",
        "swarmd.core.buffers",
        "swarmd.core.odometry_trail",
        "swarmd.protection.comparisons",
        "swarmd.protection.closing_speed",
        "swarmd.protection.barrier_assumptions",
        "swarmd.protection.outline",
        "swarmd.protection.dead_reckoning",
        "swarmd.protection.surfaces",
        "swarmd.protection.obstacles",
        "swarmd.protection.walls.straight_runs",
        "swarmd.protection.walls.bare_returns",
        "swarmd.protection.walls.standing_walls",
        "swarmd.protection.touch_zone",
        "swarmd.protection.constraints",
        "swarmd.protection.projection",
        "swarmd.protection.envelope",
        "swarmd.protection.stopping",
        "swarmd.protection.fence.fence_stops",
        "swarmd.protection.limiting_obstacles",
        "swarmd.protection.passage",
        "swarmd.protection.feasible_set",
        "swarmd.protection.barrier",
    ),
    "swarmd.protection._assumption_monitor": (
        "swarmd.core.angles",
        "swarmd.core.buffers",
        "swarmd.protection.assumption_monitor",
    ),
    "swarmd.protection._blind_zone": (
        "swarmd.core.angles",
        "swarmd.core.buffers",
        "swarmd.core.ray_order",
        "swarmd.protection.blind_zone",
    ),
    "swarmd.protection._following": (
        "swarmd.core.angles",
        "swarmd.core.buffers",
        "swarmd.protection.following",
    ),
    "swarmd.protection._protection": ("swarmd.protection.protection",),
    "swarmd.sensing._scans": (
        "swarmd.core.angles",
        "swarmd.core.buffers",
        "swarmd.core.odometry_trail",
        "swarmd.core.ray_order",
        "swarmd.sensing.ray_memory",
        "swarmd.sensing.blind_sector",
        "swarmd.sensing.conditioning",
        "swarmd.sensing.delay_by_stamps",
        "swarmd.sensing.delay_by_turns",
        "swarmd.sensing.scan_delay",
        "swarmd.sensing.odometry_history",
        "swarmd.sensing.ray_motion",
        "swarmd.sensing.deskew",
        "swarmd.sensing.scan_layout",
        "swarmd.sensing.scan_features",
    ),
    "swarmd.robot._ticker": (
        "swarmd.robot.effects",
        "swarmd.robot.pattern_run",
        "swarmd.robot.input_ages",
        "swarmd.robot.ticker",
    ),
    "swarmd.kit._points": ("swarmd.kit.points",),
    "swarmd.kin._kin": (
        "swarmd.core.angles",
        "swarmd.core.buffers",
        "swarmd.core.odometry_trail",
        "swarmd.kin.hypothesis",
        "swarmd.kin.kin",
    ),
    "swarmd.steering._steering": (
        "swarmd.core.angles",
        "swarmd.core.buffers",
        "swarmd.core.odometry_trail",
        "swarmd.core.ray_order",
        "swarmd.steering.tracks",
        "swarmd.steering.velocity_obstacles",
        "swarmd.steering.openings",
        "swarmd.steering.avoidance",
        "swarmd.steering.recovery",
        "swarmd.steering.way_settings",
        "swarmd.steering.right_of_way",
        "swarmd.steering.steering",
    ),
    "swarmd.sim.world._base": ("swarmd.core.angles", "swarmd.sim.world.base"),
    "swarmd.sim.world._ray_caster": ("swarmd.core.angles", "swarmd.sim.world.ray_caster"),
}
"""By the module name of a library: the kernels in it, each behind those that it imports.

A kernel of `swarmd.core` is compiled into each library that uses it. `load_kernel` takes the first
of these, so the libraries of what must be right come first: a damaged library of kin or steering
must not change protection.
"""

KERNELS = tuple(dict.fromkeys(chain.from_iterable(LIBRARIES.values())))

VIEWS = "swarmd.core._views"

_NOT_COMPILED = "not compiled"
_STALE = "older than its source (run make kernels)"


def load_kernel(name: str) -> Any:
    """The kernel of the module `name`: from the compiled library, or else the interpreted module.

    Logs a line for a library that was compiled from other sources. (`import` of the same name
    always gives the interpreted module.)
    """
    return _compiled(name) or import_module(name)


def describe_kernels() -> str:
    """`compiled`, or `interpreted` and the reason; imports no kernel."""
    if not _is_wanted():
        return "interpreted (SWARMD_COMPILED=0)"
    faults = {library: fault for library in LIBRARIES if (fault := _fault_of(library))}
    if not faults:
        return "compiled"
    if len(faults) == len(LIBRARIES):
        return f"interpreted ({', '.join(dict.fromkeys(faults.values()))})"
    named = (f"{_short(library)} is {fault}" for library, fault in faults.items())
    return f"compiled, but {', '.join(named)}"


def source_of(name: str) -> str:
    """The path of a kernel's file in the repository."""
    return name.replace(".", "/").replace("swarmd/sim/", "sim/") + ".py"


def digest_of(sources: list[bytes]) -> str:
    """The digest of the sources of a library."""
    return hashlib.sha256(b"".join(sources)).hexdigest()


def _compiled(name: str) -> Any:
    """The imported library of a kernel; None if the file must be interpreted."""
    library = next((library for library, names in LIBRARIES.items() if name in names), None)
    if library is None or not _is_wanted() or _fault_of(library):
        return None
    try:
        return import_module(library)
    except ImportError:  # built for another processor
        return None


def _is_wanted() -> bool:
    return os.environ.get("SWARMD_COMPILED", "1") != "0"


@cache
def _fault_of(name: str) -> str:
    """Why a library cannot be used; empty if it can. Opens the library without importing it."""
    path = _file(name)
    library = _opened(name)
    views = _opened(VIEWS)
    if path is None or library is None or views is None:
        return _NOT_COMPILED
    root = path.parents[name.count(".")]
    files = (root / f"{one.replace('.', '/')}.py" for one in LIBRARIES[name])
    sources = [file.read_bytes() for file in files if file.exists()]
    is_stale = _digest_in(library, "views_digest") != _digest_in(views, "views_digest")
    if sources:
        is_stale |= _digest_in(library, "source_digest") != digest_of(sources)
    if is_stale:
        import logging  # rarely needed, and swarmctl starts fast

        logging.getLogger(__name__).warning("kernel %s is %s", _short(name), _STALE)
        return _STALE
    return ""


@cache
def _opened(name: str) -> ctypes.CDLL | None:
    path = _file(name)
    try:
        return None if path is None else ctypes.CDLL(str(path))
    except OSError:  # damaged, or built for another processor
        return None


def _digest_in(library: ctypes.CDLL, name: str) -> str:
    """The digest `name` that setup.py put into a library; empty without one."""
    try:
        return (ctypes.c_char * 64).in_dll(library, name).value.decode()
    except ValueError:
        return ""


def _short(library: str) -> str:
    """A library as messages name it."""
    return library.rpartition(".")[2].removeprefix("_")


def _file(name: str) -> Path | None:
    """The file of a library; None if the file is absent or incomplete.

    To load a truncated file may end the process with SIGBUS. An ELF file ends with its section
    table, whose place is in the header: a file that ends before is truncated.
    """
    spec = find_spec(name)
    if spec is None or spec.origin is None or not spec.origin.endswith(".so"):
        return None
    path = Path(spec.origin)
    with path.open("rb") as file:
        header = file.read(64)
    if header[:5] == b"\x7fELF\x02":
        if len(header) < 64:
            return None
        order = "<" if header[5] == 1 else ">"
        (table,) = struct.unpack_from(order + "Q", header, 40)
        size, count = struct.unpack_from(order + "HH", header, 58)
        if path.stat().st_size < table + size * count:
            return None
    return path
