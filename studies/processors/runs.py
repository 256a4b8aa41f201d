"""Traces of short scenarios on this machine, what its functions give, and variants of x86-64."""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from swarmd.core.pin import pinned_environment
from swarmd.core.values import Array
from swarmd.sim.experiments.provenance import made_with
from swarmd.sim.experiments.trace_differences import first_difference, trace_differences
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.trace import load_trace

ROOT = Path(__file__).resolve().parents[2]
SCENARIOS: Mapping[str, float] = {
    "flocking": 10.0,
    "paper_exp1_burger": 15.0,
    "doorway": 15.0,
    "voter_model": 15.0,
    "random_walk": 15.0,
    "pushed_box": 15.0,
    "mixed_real": 10.0,
    "patrol": 15.0,
    "follow_wall": 15.0,
    "cooperative_transport": 10.0,
    "pucks": 10.0,
    "crazyflies": 10.0,
}
"""The s of each scenario."""
SEED = 1
FACTS = "facts.json"
_OLDER = "-AVX,-AVX512F,-SSE4_1,-SSE4_2,-SSSE3,-ERMS,-FSRM"
_OF_PIN = ("GLIBC_TUNABLES", "NPY_DISABLE_CPU_FEATURES", "OPENBLAS_CORETYPE")
_POINTS = 3001  # arguments of a function


class Variant(NamedTuple):
    """A way in which this machine computes."""

    environment: Mapping[str, str]
    cores: int = 1
    is_equal: bool = True
    """Whether it changes the program alone, and so no bit."""
    is_pinned: bool = False
    """Whether its process is pinned: compared with a pinned process, it changes no bit."""


def variants() -> dict[str, Variant]:
    """The variants by name that this machine has.

    GLIBC_TUNABLES chooses among the functions of glibc on x86-64, NPY_DISABLE_CPU_FEATURES among
    those of numpy, OPENBLAS_CORETYPE among the products of OpenBLAS. Pinned variants are compared
    with a pinned process, the others with one that is not, also if this one is.
    """
    found = {
        "another hash seed": Variant({"PYTHONHASHSEED": "7"}),
        "interpreted kernels": Variant({"SWARMD_COMPILED": "0"}),
        "two processes": Variant({}, cores=2),
    }
    if platform.machine() != "x86_64":
        return found
    processor: dict[str, str] = {}
    flags = Path("/proc/cpuinfo").read_text()
    if platform.libc_ver()[0] == "glibc" and " fma " in flags:
        libm = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2"}
        found["libm without FMA"] = Variant(libm, is_equal=False)
        processor |= libm
    simd_of_numpy = np.show_config(mode="dicts")["SIMD Extensions"]
    # In a pinned process those of this processor are not found, too; numpy ignores all others.
    if features := [*simd_of_numpy.get("found", ()), *simd_of_numpy.get("not found", ())]:
        simd = {"NPY_DISABLE_CPU_FEATURES": " ".join(features)}
        found["numpy without SIMD"] = Variant(simd, is_equal=False)
        processor |= simd
    blas = {"OPENBLAS_CORETYPE": "Nehalem"}
    found["OpenBLAS of Nehalem"] = Variant(blas, is_equal=False)
    found["all three"] = Variant(processor | blas, is_equal=False)
    # As processors of other years compute, each pinned: the pin leaves the rest of these words.
    older = {"GLIBC_TUNABLES": f"glibc.cpu.hwcaps={_OLDER}"}
    found["pinned, glibc of an older processor"] = Variant(older, is_pinned=True)
    found["pinned, all three, interpreted kernels"] = Variant(
        processor | older | {"OPENBLAS_CORETYPE": "Sandybridge", "SWARMD_COMPILED": "0"},
        is_pinned=True,
    )
    return found


def run_variant(variant: Variant, folder: Path, names: Iterable[str], share: float = 1.0) -> None:
    """`write_traces` in a process of its own, unless `folder` has all that it writes.

    subprocess.CalledProcessError if it fails.
    """
    if (folder / FACTS).exists():
        return
    command = [sys.executable, "-m", "studies.processors", "traces", str(folder)]
    subprocess.run(
        [*command, "--share", str(share), "--cores", str(variant.cores), "--only", *names],
        env=_environment(variant),
        cwd=ROOT,
        check=True,
    )


def _environment(variant: Variant) -> dict[str, str]:
    """The environment of a variant; without the pin of this process, such as that of a night."""
    environment = {name: value for name, value in os.environ.items() if name not in _OF_PIN}
    environment |= variant.environment
    return pinned_environment(environment) if variant.is_pinned else environment


def write_traces(folder: Path, names: Iterable[str], *, share: float = 1.0, cores: int = 1) -> None:
    """Write the trace of each scenario, and last FACTS, to `folder`.

    `share`: of the seconds of each scenario. A line for each scenario goes to the standard error.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        began = time.monotonic()
        seconds = SCENARIOS[name] * share
        trace = simulate_run(load_scenario(name), SEED, cores=cores, seconds=seconds)
        trace.save(folder / f"{name}.npz")
        took = time.monotonic() - began
        print(f"{name}: {seconds:g} s simulated in {took:.1f} s", file=sys.stderr, flush=True)
    (folder / FACTS).write_text(json.dumps({**made_with(), **digests()}, indent=2) + "\n")


def differences(a: Path, b: Path) -> dict[str, str]:
    """By scenario of both folders, how the traces differ: empty if they are equal to the bit.

    Else the first instant with the fields that differ then, or the differing fields without one.
    """
    found = {}
    for name in SCENARIOS:
        paths = [folder / f"{name}.npz" for folder in (a, b)]
        if all(path.exists() for path in paths):
            one, other = map(load_trace, paths)
            fields = trace_differences(one, other)
            found[name] = (first_difference(one, other) or ", ".join(fields)) if fields else ""
    return found


def differing_facts(a: Path, b: Path) -> list[str]:
    """The names in FACTS whose values differ between two folders."""
    one, other = (json.loads((folder / FACTS).read_text()) for folder in (a, b))
    return [name for name in one if one[name] != other.get(name)]


def digests() -> dict[str, str]:
    """By name, a digest of what each elementary function, sum, product and step gives here."""
    return {
        name: hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()[:8]
        for name, values in {**_of_libm(), **_of_numpy(), **_of_mujoco()}.items()
    }


def _arguments() -> tuple[dict[str, Array], Array, Array]:
    """The arguments by function of one argument, and those of functions of two."""
    x = np.linspace(-0.999, 0.999, _POINTS)
    positive = 3.0 + 2.5 * x
    by_name = {
        **dict.fromkeys(("sin", "cos", "tan", "atan", "exp", "expm1", "tanh"), 7.0 * x),
        **dict.fromkeys(("asin", "acos"), x),
        **dict.fromkeys(("log", "log2", "log10", "log1p", "sqrt"), positive),
    }
    return by_name, positive, positive[::-1].copy()


def _of_libm() -> dict[str, Array]:
    of_one, x, y = _arguments()
    found = {
        f"math.{name}": np.array([getattr(math, name)(value) for value in values])
        for name, values in of_one.items()
    }
    for name in ("atan2", "hypot", "pow", "fmod", "remainder"):
        function = getattr(math, name)
        found[f"math.{name}"] = np.array([function(a, b) for a, b in zip(x, y, strict=True)])
    # CPython's math.hypot is its own code.
    found["hypot of libm"] = np.array([abs(complex(a, b)) for a, b in zip(x, y, strict=True)])
    return found


def _of_numpy() -> dict[str, Array]:
    of_one, x, y = _arguments()
    names = {"asin": "arcsin", "acos": "arccos", "atan": "arctan"}
    found = {
        f"numpy.{names.get(name, name)}": getattr(np, names.get(name, name))(values)
        for name, values in of_one.items()
    }
    square = x[:900].reshape(30, 30) + np.eye(30)
    draws = np.random.default_rng
    return found | {
        "numpy.arctan2": np.arctan2(x, y),
        "numpy.hypot": np.hypot(x, y),
        "numpy.power": np.power(x, y),
        "numpy.sum": np.array([x.sum(), x[:7].sum()]),
        "numpy.mean": x[:14].reshape(7, 2).mean(axis=0),
        "numpy.einsum": np.einsum("ij,kj->ik", square, square),
        "numpy.dot": np.array([x @ y]),
        "numpy.matmul": square @ square,
        "numpy.matmul, n x 2": x[:2000].reshape(1000, 2) @ square[:2, :2],
        "numpy.linalg.solve": np.linalg.solve(square, x[:30]),
        "numpy.linalg.lstsq": np.linalg.lstsq(square[:, :3], x[:30], rcond=None)[0],
        "numpy.random.uniform": draws(1).uniform(-1.0, 1.0, size=_POINTS),
        "numpy.random.normal": draws(1).normal(size=_POINTS),
        "numpy.random.exponential": draws(1).exponential(size=_POINTS),
    }


_WORLD = """<mujoco><option timestep="0.01"/><worldbody>
<geom type="box" size="0.1 1 0.1" pos="{wall} 0 0"/>
<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
<joint type="hinge" axis="0 0 1"/><geom type="cylinder" size="0.1 0.1" mass="1.3"/></body>
</worldbody></mujoco>"""


def _of_mujoco() -> dict[str, Array]:
    return {"mujoco.mj_step": _stepped(wall=10.0), "mujoco.mj_step, touching": _stepped(wall=0.4)}


def _stepped(wall: float, steps: int = 200) -> Array:
    """Positions and speeds of a body that turns and drives towards a wall at a distance in m."""
    model = mujoco.MjModel.from_xml_string(_WORLD.format(wall=wall))
    data = mujoco.MjData(model)
    data.qvel[:] = 0.3, 0.011, 0.7
    step: Callable[..., None] = mujoco.mj_step
    rows = []
    for _ in range(steps):
        step(model, data)
        rows.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(rows)
