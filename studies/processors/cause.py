"""The first call of an elementary function that gives other bits for the same arguments.

Two processes run one scenario, and `elementary.c` writes what the C library's functions give to two
pipes. Calls of numpy's functions and MuJoCo's steps are in the same sequence, as digests. The first
difference of the two sequences is the cause of all that follow: either a function gave another
result for equal arguments, or the arguments differ, and then something that is not in the sequence
(a sum, an operator of numpy) is the cause.
"""

from __future__ import annotations

import ctypes
import faulthandler
import functools
import hashlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, NamedTuple

import mujoco
import numpy as np

from studies.processors.runs import ROOT, SEED
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import load_scenario

OF_LIBM = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "exp", "expm1", "log", "log2", "log10"),
    *("log1p", "sinh", "cosh", "tanh", "atan2", "pow", "hypot"),
)
"""By the places of elementary.c."""
OF_NUMPY = (
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "exp", "expm1", "log", "log2"),
    *("log10", "log1p", "sinh", "cosh", "tanh", "power", "hypot", "einsum", "dot"),
)
OF_LINALG = ("solve", "lstsq", "inv", "norm", "svd", "eigh", "det")
NAMES = (
    *OF_LIBM,
    *(f"numpy.{name}" for name in OF_NUMPY),
    *(f"numpy.linalg.{name}" for name in OF_LINALG),
    "mujoco.mj_step",
)
OF_TWO = ("atan2", "pow", "hypot")
_RECORD = 32
_BLOCK = 1 << 16  # bytes of a read
SOURCE = Path(__file__).with_name("elementary.c")


def build(library: Path, compiler: str = "gcc") -> None:
    """Compile elementary.c; subprocess.CalledProcessError if that fails.

    gcc is for this machine. Another compiler is for a machine whose long double has 113 bits.
    """
    options = ("-O1", "-fno-builtin", "-shared", "-fPIC", "-o", str(library), str(SOURCE))
    quad = ("-lquadmath",) if compiler == "gcc" and os.uname().machine == "x86_64" else ()
    subprocess.run([compiler, *options, *quad, "-ldl", "-lm", "-lpthread"], check=True)


def write_calls(scenario: str, seconds: float, path: Path, at: int) -> None:
    """Run a scenario in this process, which has elementary.c before its libm, and write its calls.

    At call `at` the stack goes to the standard error, unless it is negative.
    """
    faulthandler.register(signal.SIGUSR2, all_threads=False)
    library = ctypes.CDLL(None)
    _note_numpy(library)
    found = load_scenario(scenario)
    simulate_run(found, SEED, seconds=0.02)  # imports what a run needs
    library.elementary_log(os.fsencode(path), ctypes.c_long(at))
    simulate_run(found, SEED, seconds=seconds)


def _note_numpy(library: ctypes.CDLL) -> None:
    """Have calls of numpy and MuJoCo noted, too."""

    def noted(function: Callable[..., Any], name: str, state: Callable[..., Any]) -> Any:
        place = NAMES.index(name)

        @functools.wraps(function)
        def call(*args: Any, **options: Any) -> Any:
            got = _digest(state(args))
            library.elementary_begin()
            try:
                result = function(*args, **options)
            except BaseException:
                library.elementary_end(place, got, b"\0" * 8)
                raise
            library.elementary_end(place, got, _digest(state(args) if result is None else result))
            return result

        return call

    for owner, prefix, names in ((np, "numpy", OF_NUMPY), (np.linalg, "numpy.linalg", OF_LINALG)):
        for name in names:
            function = noted(getattr(owner, name), f"{prefix}.{name}", lambda args: args)
            setattr(owner, name, function)
    step = noted(mujoco.mj_step, "mujoco.mj_step", lambda args: _state_of(args[1]))
    mujoco.mj_step = step


def first_difference(one: BinaryIO, other: BinaryIO) -> tuple[int, bytes, bytes] | None:
    """The place and both records of the first difference of two sequences, or None."""
    place = 0
    while True:
        a, b = one.read(_BLOCK), other.read(_BLOCK)
        if a != b:
            for k in range(0, max(len(a), len(b)), _RECORD):
                if a[k : k + _RECORD] != b[k : k + _RECORD]:
                    return place + k // _RECORD, a[k : k + _RECORD], b[k : k + _RECORD]
        if not a:
            return None
        place += len(a) // _RECORD


def described(one: bytes, other: bytes) -> tuple[str, str]:
    """The function that is the cause, and what it gave; an empty name if none of NAMES is."""
    if not one or not other:
        return "", "one of the runs ends first"
    (function, x, y, result), (second, *_, result2) = (np.frombuffer(r) for r in (one, other))
    name = NAMES[int(function)]
    if function != second:
        return "", f"{name} here, {NAMES[int(second)]} there"
    if one[:24] != other[:24]:
        return "", f"the arguments of {name} differ"
    if int(function) >= len(OF_LIBM):
        return name, "other bits for equal arguments"
    arguments = f"{float(x)!r}" + (f", {float(y)!r}" if name in OF_TWO else "")
    return name, f"{name}({arguments}) is {float(result)!r} here, {float(result2)!r} there"


class Cause(NamedTuple):
    """The first difference of two sequences of calls."""

    function: str
    """One of NAMES; empty if something is the cause that is not in the sequence."""
    text: str
    place: int
    """How many calls came before."""
    line: str
    """The file and line of Python from which the call came."""


class Side(NamedTuple):
    """One of two ways to run a scenario."""

    environment: Mapping[str, str]
    prefix: Sequence[str] = ()
    """The command in front of `env ... python`, such as one that enters another root file system,
    with the temporary folder of this one and a copy of ROOT as its working folder."""
    python: str = sys.executable
    compiler: str = "gcc"


def first_cause(scenario: str, seconds: float, here: Side, there: Side) -> Cause | None:
    """The first cause of a difference between two sides; None if their sequences are equal."""
    with TemporaryDirectory() as folder:
        sides = {"here": here, "there": there}
        libraries = {name: Path(folder) / f"{name}.so" for name in sides}
        pipes = {name: Path(folder) / name for name in sides}
        runs = []
        try:
            for name, side in sides.items():
                build(libraries[name], side.compiler)
                os.mkfifo(pipes[name])
                runs.append(_start(scenario, seconds, side, libraries[name], pipes[name]))
            with pipes["here"].open("rb") as one, pipes["there"].open("rb") as other:
                found = first_difference(one, other)
        finally:
            for run in runs:
                run.kill()
                run.communicate()
        if found is None:
            return None
        place, a, b = found
        run = _start(scenario, seconds, here, libraries["here"], Path(os.devnull), at=place)
        return Cause(*described(a, b), place, _line_of(run))


def _start(
    scenario: str, seconds: float, side: Side, library: Path, to: Path, *, at: int = -1
) -> subprocess.Popen[str]:
    """A run that writes its calls to a file, and its stack at call `at` to the standard error."""
    more = {**side.environment, "LD_PRELOAD": str(library)}
    assignments = [f"{name}={value}" for name, value in more.items()]
    command = ["-m", "studies.processors", "calls", scenario, str(to)]
    options = ["--seconds", str(seconds), "--at", str(at)]
    return subprocess.Popen(
        [*side.prefix, "env", *assignments, side.python, *command, *options],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
    )


def _line_of(run: subprocess.Popen[str]) -> str:
    """The innermost file and line of this project in the stack that a run writes."""
    _, text = run.communicate()
    found = re.findall(r'File "([^"]+)", line (\d+)', text)
    for file, line in found:
        path = Path(file).resolve()
        is_own = path.is_relative_to(ROOT) and ".venv" not in path.parts
        if is_own and not path.is_relative_to(SOURCE.parent):
            return f"{path.relative_to(ROOT)}:{line}"
    return "unknown"


def _state_of(data: Any) -> list[Any]:
    """What a step of MuJoCo gets and gives, without what it computes on the way."""
    return [data.qpos, data.qvel, data.ctrl, data.qfrc_applied, data.xfrc_applied]


def _digest(values: Any) -> bytes:
    """8 bytes for the bits of arrays, numbers, and lists of these."""
    digest = hashlib.blake2b(digest_size=8)
    for value in values if isinstance(values, list | tuple) else (values,):
        digest.update(np.ascontiguousarray(value).tobytes())
    return digest.digest()
