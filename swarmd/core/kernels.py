"""The kernels: files with arithmetic on scans and near points, which Cython compiles.

A kernel's file is the only source of its arithmetic; a `.pxd` beside it has what C needs beyond it
(`kernel_types.py`). The file reads as Python, and `import` of its name gives what runs: the
compiled module, or else the interpreted one. `swarmd/__init__.py` installs the `KernelFinder`,
which Python asks before it looks for a file. Under `SWARMD_COMPILED=0` it finds nothing; a test
gets both forms in one process by tests/support/kernel_forms.py.

`setup.py` builds the libraries of LIBRARIES. A library is one file along a line of trust: what must
be right (`_trusted`), what may be wrong since protection judges it (`_led`), and the simulated
world. It consists of units. A unit is a module of its own, in which Cython has joined the kernels
that call each other's functions of C: from one unit to another, a call with nine arrays takes 8 us,
and the cheapest one 50 ns. So a kernel of `swarmd.core` that many use is in several units, each
with its own copy of the code.

CPython interprets the files of a library if

- there is no library,
- the environment has SWARMD_COMPILED=0,
- the library was compiled from other sources than the present files: callers might use functions
  that it lacks,
- the library `_views` is absent or was compiled by another version of Cython. All libraries import
  it, since it contains Cython's code for memory views.

setup.py runs this file alone, and `import swarmd` runs it: so it imports no other module of swarmd,
and nothing at its top that takes time.

Reasons and measurements:

- There are several units since these compile in parallel, and a process begins only those that it
  imports: a pattern needs `kit.points` alone, and steering and kin would take 16 ms of its start.
  All calls from one unit to another take an estimated 2 % of the time with 100 robots.
- A kernel's function without a result has the type `int` in its `.pxd`, and C returns 0. Cython
  passes an exception by the value -1, so its caller need not ask for an exception after each call.
- The copies of kernels of `swarmd.core` in further units are 4 % of the C code: three of
  `odometry_trail` are 2.5 %, and the rest are short functions, which each unit needs for itself.
- To compile classes of Python as they are gained nothing. The gain comes from C fields, buffers of
  doubles and fewer calls.
- Time of an event (a scan or a decision) in mode barrier, in recorded runs: 1.01 ms by a version in
  numpy, 0.71 ms by this source interpreted, 0.07 ms compiled.
- A run of seven robots in lockstep took, interpreted, 1.1 to 1.35 times the time of numpy.
- numba was refused: it adds 117 MB to a daemon.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from importlib.machinery import ExtensionFileLoader, ModuleSpec, PathFinder
from itertools import chain
from types import ModuleType
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    import ctypes
    from importlib.abc import Loader

LIBRARIES: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "swarmd._trusted": {
        "swarmd.robot.protection._barrier": (
            "swarmd.core.angles",
            "swarmd.core.buffers",
            "swarmd.core.odometry_trail",
            "swarmd.core.ray_order",
            "swarmd.robot.protection.comparisons",
            "swarmd.robot.protection.closing_speed",
            "swarmd.robot.protection.barrier_assumptions",
            "swarmd.robot.protection.outline",
            "swarmd.robot.protection.dead_reckoning",
            "swarmd.robot.protection.surfaces",
            "swarmd.robot.protection.obstacles",
            "swarmd.robot.protection.walls.straight_runs",
            "swarmd.robot.protection.walls.bare_returns",
            "swarmd.robot.protection.walls.standing_walls",
            "swarmd.robot.protection.touch_zone",
            "swarmd.robot.protection.constraints",
            "swarmd.robot.protection.projection",
            "swarmd.robot.protection.envelope",
            "swarmd.robot.protection.stopping",
            "swarmd.robot.protection.fence.fence_stops",
            "swarmd.robot.protection.limiting_obstacles",
            "swarmd.robot.protection.passage",
            "swarmd.robot.protection.feasible_set",
            "swarmd.robot.protection.blind_zone",
            "swarmd.robot.protection.barrier",
        ),
        "swarmd.robot.protection._protection": (
            "swarmd.core.angles",
            "swarmd.core.buffers",
            "swarmd.robot.protection.assumption_monitor",
            "swarmd.robot.protection.following",
            "swarmd.robot.protection.protection",
        ),
        "swarmd.robot.sensing._scans": (
            "swarmd.core.angles",
            "swarmd.core.buffers",
            "swarmd.core.odometry_trail",
            "swarmd.core.ray_order",
            "swarmd.robot.sensing.ray_memory",
            "swarmd.robot.sensing.blind_sector",
            "swarmd.robot.sensing.conditioning",
            "swarmd.robot.sensing.delay_by_stamps",
            "swarmd.robot.sensing.delay_by_turns",
            "swarmd.robot.sensing.scan_delay",
            "swarmd.robot.sensing.odometry_history",
            "swarmd.robot.sensing.ray_motion",
            "swarmd.robot.sensing.deskew",
            "swarmd.robot.sensing.scan_layout",
            "swarmd.robot.sensing.scan_features",
        ),
        "swarmd.robot._ticker": (
            "swarmd.robot.effects",
            "swarmd.robot.pattern_run",
            "swarmd.robot.input_ages",
            "swarmd.robot.state_machine",
            "swarmd.robot.ticker",
        ),
    },
    "swarmd._led": {
        "swarmd.robot.steering._steering": (
            "swarmd.core.angles",
            "swarmd.core.buffers",
            "swarmd.core.odometry_trail",
            "swarmd.core.ray_order",
            "swarmd.robot.steering.tracks",
            "swarmd.robot.steering.velocity_obstacles",
            "swarmd.robot.steering.openings",
            "swarmd.robot.steering.avoidance",
            "swarmd.robot.steering.recovery",
            "swarmd.robot.steering.way_settings",
            "swarmd.robot.steering.right_of_way",
            "swarmd.robot.steering.steering",
        ),
        "swarmd.robot.kin._kin": (
            "swarmd.core.angles",
            "swarmd.core.buffers",
            "swarmd.core.odometry_trail",
            "swarmd.robot.kin.hypothesis",
            "swarmd.robot.kin.sight_fit",
            "swarmd.robot.kin.kin",
        ),
        "swarmd.kit._points": ("swarmd.kit.points",),
    },
    "swarmd.sim._world": {
        "swarmd.sim.world._world": (
            "swarmd.core.angles",
            "swarmd.sim.world.base",
            "swarmd.sim.world.ray_caster",
        ),
    },
}
"""By the module name of a library: its units, and in each the kernels, behind those they import.

This says what is built. `import` takes a kernel of `swarmd.core` from the first unit that has it,
so what must be right comes first: a damaged library of what is led must not change protection.
"""

UNITS: Mapping[str, tuple[str, ...]] = {
    unit: kernels for units in LIBRARIES.values() for unit, kernels in units.items()
}
KERNELS = tuple(dict.fromkeys(chain.from_iterable(UNITS.values())))

VIEWS = "swarmd.core._views"

HELPERS = ("swarmd.core.angles", "swarmd.core.buffers", "swarmd.core.ray_order")
"""Kernels of C functions alone, which units take into themselves: `import` gives their source."""

_LIBRARY_OF = {unit: library for library, units in LIBRARIES.items() for unit in units}
_UNIT_OF = {
    kernel: unit for unit in reversed([*UNITS]) for kernel in UNITS[unit] if kernel not in HELPERS
}
_NOT_COMPILED = "not compiled"
_SECTION_OF_NAMES = 3  # SHT_STRTAB of ELF
_STALE = "older than its source (run make kernels)"


class KernelFinder:
    """Finds the compiled form of a kernel, and the units in libraries; nothing else."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """What loads a compiled module; None if it is no kernel or must be interpreted."""
        unit = _UNIT_OF.get(name, name)
        library = _LIBRARY_OF.get(unit)
        if library is None or not _is_wanted() or _fault_of(library):
            return None
        file = _file(library)
        if file is None:
            return None
        if name == unit:
            return ModuleSpec(name, ExtensionFileLoader(name, file), origin=file)
        return ModuleSpec(name, cast("Loader", _KernelLoader(unit, path)), origin=file)


class _KernelLoader:
    """Gives a module the names that a kernel has in its unit."""

    def __init__(self, unit: str, path: Sequence[str] | None) -> None:
        self._unit = unit
        self._path = path

    def create_module(self, spec: ModuleSpec) -> None:
        """None: Python makes the module."""

    def exec_module(self, module: ModuleType) -> None:
        """Fill the module. Its file is the source, which `inspect` and tracebacks show."""
        source = PathFinder.find_spec(module.__name__, self._path)
        if source is not None and source.origin is not None:
            module.__file__ = source.origin
        unit = import_module(self._unit)
        if module.__name__ not in unit.NAMES:
            raise ImportError(f"{module.__name__} is imported in a circle", name=module.__name__)
        vars(module).update(unit.NAMES[module.__name__], __unit__=unit)


def install_finder() -> None:
    """Let `import` find compiled kernels, from now on in this process."""
    if KernelFinder not in sys.meta_path:
        sys.meta_path.insert(0, KernelFinder)


def unit_of(name: str) -> ModuleType:
    """The compiled unit of a module; the module itself if it is no kernel, or interpreted."""
    module = import_module(name)
    unit: ModuleType = getattr(module, "__unit__", module)
    return unit


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


def files_of(name: str) -> tuple[str, str]:
    """The paths in the repository of a kernel's file, and of its `.pxd`, which may be absent."""
    source = source_of(name)
    return source, source.removesuffix("py") + "pxd"


def kernels_of(library: str) -> tuple[str, ...]:
    """The kernels in a library, each once."""
    return tuple(dict.fromkeys(chain.from_iterable(LIBRARIES[library].values())))


def digest_of(sources: list[bytes]) -> str:
    """The digest of the sources of a library."""
    import hashlib  # each `import swarmd` runs this file

    return hashlib.sha256(b"".join(sources)).hexdigest()


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
    from pathlib import Path  # each `import swarmd` runs this file

    root = Path(path).parents[name.count(".")]
    bases = (root / one.replace(".", "/") for one in kernels_of(name))
    files = (base.with_suffix(suffix) for base in bases for suffix in (".py", ".pxd"))
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
    import ctypes  # takes 3 ms, and not of a process without kernels

    path = _file(name)
    try:
        return None if path is None else ctypes.CDLL(path)
    except OSError:  # damaged, or built for another processor
        return None


def _digest_in(library: ctypes.CDLL, name: str) -> str:
    """The digest `name` that setup.py put into a library; empty without one."""
    import ctypes  # takes 3 ms, and not of a process without kernels

    try:
        return (ctypes.c_char * 64).in_dll(library, name).value.decode()
    except ValueError:
        return ""


def _short(library: str) -> str:
    """A library as messages name it."""
    return library.rpartition(".")[2].removeprefix("_")


@cache
def _file(name: str) -> str | None:
    """The file of a library; None if the file is absent, incomplete, or cannot be read.

    To load a truncated file may end the process with SIGBUS, and one whose end is zeros, as after a
    loss of power, with SIGSEGV. An ELF file ends with its section table, whose place is in the
    header: a file that ends before is truncated, and the table names the kind of the section of
    names.
    """
    import struct  # each `import swarmd` runs this file
    from importlib.util import find_spec

    try:
        spec = find_spec(name)
        if spec is None or spec.origin is None or not spec.origin.endswith(".so"):
            return None
        with open(spec.origin, "rb") as file:
            header = file.read(64)
            if header[:5] == b"\x7fELF\x02":
                if len(header) < 64:
                    return None
                order = "<" if header[5] == 1 else ">"
                (table,) = struct.unpack_from(order + "Q", header, 40)
                size, count, names = struct.unpack_from(order + "HHH", header, 58)
                if os.stat(spec.origin).st_size < table + size * count:
                    return None
                file.seek(table + size * names)
                if names and struct.unpack(order + "LL", file.read(8))[1] != _SECTION_OF_NAMES:
                    return None
    except (OSError, ModuleNotFoundError):  # no right to read it, or no `swarmd.sim` here
        return None
    return spec.origin
