"""Robot-seconds a CPU-second beside other simulators: `make night ARGS=rivals`.

`python -m benchmarks.rivals --rounds 1 --sizes 7 --only Enki VMAS` measures a part. In a round each
simulator steps each cell once, on one processor, one after the other; a ratio is taken within a
round, so that other work on the machine changes both of its sides.

What is missing is left out with a line that says how to get it. The environment names where it is:
`ENKI=/prefix`, `ARGOS=/prefix`, `IR_SIM=/venv/bin/python`, `VMAS=/venv/bin/python`.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.learning import AGENTS, rates
from benchmarks.table import machine, markdown

HERE = Path(__file__).resolve().parent
BUILD = Path("build", "rivals").absolute()
SIZES = (7, 100, 1000)
RAYS = (8, 24, 360)
RANGES = {8: 1.2, 24: 1.2, 360: 3.5}
"""The range of the rays in m by their number."""
NEAR = 0.5  # m; from what is nearer ahead a robot turns
ROUNDS = 3
SECONDS = 0.5  # of the processor, for a sample
LIMIT = 30  # CPU-s of a program: a cell that takes longer stays empty, and so do larger ones
TASKS = ("navigation_360", "navigation", "flocking", "discovery", "sampling")
"""The tasks of vmas_steps.py, which runs in another interpreter."""
VMAS_RAYS = {"navigation_360": 360, "discovery": 27}  # of an agent; 12 in the others

Command = Sequence[str]
Sample = tuple[float, float]
"""What was simulated, in robot-seconds or steps of agents, and its CPU seconds."""


class Missing(Exception):
    """What a simulator lacks here, and how to get it."""


@dataclass(frozen=True, slots=True)
class Simulator:
    """A row of the tables.

    computes: what a step computes, and what it leaves out. program: makes the program if necessary,
    and returns its command without the words of a cell; Missing if it cannot. words: behind those
    of a cell. rays: the numbers of rays that it has.
    """

    name: str
    computes: str
    program: Callable[[], Command]
    words: tuple[str, ...] = ()
    rays: Sequence[int] = RAYS


def swarmd() -> Command:
    return (sys.executable, "-m", "benchmarks.rivals.swarmd_steps")


def enki() -> Command:
    """Compiled against $ENKI, else against the system's."""
    prefix = os.environ.get("ENKI")
    where = [f"-I{prefix}/include", f"-L{prefix}/lib", f"-Wl,-rpath,{prefix}/lib"] if prefix else []
    program = BUILD / "enki_steps"
    remedy = "apt install libenki-dev g++, or ENKI=/prefix of github.com/enki-community/enki"
    _compile([*where, "-o", str(program), str(HERE / "enki_steps.cpp"), "-lenki"], remedy)
    return (str(program),)


def argos() -> Command:
    """Compiled against the ARGoS that is installed in $ARGOS."""
    prefix = Path(os.environ.get("ARGOS", "/usr/local"))
    remedy = "build github.com/ilpincy/argos3, make install, and give ARGOS=/prefix"
    if not (prefix / "bin" / "argos3").exists():
        raise Missing(f"no {prefix}/bin/argos3; {remedy}")
    library = BUILD / "libargos_steps.so"
    source = str(HERE / "argos_steps.cpp")
    words = [f"-I{prefix}/include", "-std=c++17", "-fPIC", "-shared", "-o", str(library), source]
    _compile(words, remedy)
    return (sys.executable, str(HERE / "argos_steps.py"), str(prefix), str(library))


def _compile(words: Sequence[str], remedy: str) -> None:
    BUILD.mkdir(parents=True, exist_ok=True)
    try:
        subprocess.run(["g++", "-O2", *words], check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        said = (getattr(error, "stderr", "") or str(error)).strip().splitlines()
        raise Missing(f"it cannot be compiled ({said[0]}); {remedy}") from error


def ir_sim() -> Command:
    remedy = "python -m venv DIR, DIR/bin/pip install ir-sim, and give IR_SIM=DIR/bin/python"
    return _script("irsim_steps.py", "IR_SIM", ("irsim",), remedy)


def vmas() -> Command:
    remedy = "install vmas and torch into an environment, and give VMAS=DIR/bin/python"
    return _script("vmas_steps.py", "VMAS", ("torch", "vmas"), remedy)


def _script(name: str, variable: str, modules: Sequence[str], remedy: str) -> Command:
    """A program of the interpreter that an environment variable names."""
    python = os.environ.get(variable, sys.executable)
    # Not in this folder, whose files have names of their own.
    found = f"import importlib.util as u; raise SystemExit(not all(map(u.find_spec, {modules!r})))"
    try:
        status = subprocess.run([python, "-c", found], cwd=BUILD.anchor, check=False).returncode
    except OSError as error:
        raise Missing(f"{python}: {error.strerror}; {remedy}") from error
    if status != 0:
        raise Missing(f"{python} has not all of {', '.join(modules)}; {remedy}")
    return (python, "-W", "ignore", str(HERE / name))


SIMULATORS = (
    Simulator(
        "swarmd",
        "physics of bodies (MuJoCo), noisy rays of different ages, delays, odometry, radio,"
        " protection `barrier`, a pattern, the trace",
        swarmd,
        ("barrier",),
    ),
    Simulator("swarmd, protection off", "the same without protection", swarmd, ("off",)),
    Simulator(
        "Enki", "physics of discs, exact rays; no noise, delays, radio, protection; C++", enki
    ),
    Simulator(
        "ARGoS",
        "physics of foot-bots (`dynamics2d`), 24 rays of 0.1 m; no noise, delays, radio,"
        " protection; C++",
        argos,
        rays=(24,),
    ),
    Simulator(
        "ir-sim",
        "motion alone: robots pass through each other; rays with noise if they are 360; no delays,"
        " radio, protection",
        ir_sim,
    ),
    *(
        Simulator(
            f"VMAS, {count} environment{'s' * (count > 1)}",
            "discs with forces, exact rays that see no walls; no noise, delays, radio, protection",
            vmas,
            (str(count),),
        )
        for count in (1, 32)
    ),
)
OWN = SIMULATORS[0].name
"""Ratios are to this row."""


def programs(simulators: Iterable[Simulator]) -> tuple[dict[str, Command], list[str]]:
    """The command of each simulator by its name, and a line for each one that is left out."""
    found: dict[str, Command] = {}
    missing: list[str] = []
    for one in simulators:
        try:
            found[one.name] = one.program()
        except Missing as error:
            missing.append(f"{one.name} is left out: {error}.")
    return found, missing


def sample(command: Command, limit: int = LIMIT) -> Sample | None:
    """What a program printed; None, with a line on the standard error, if it failed."""
    alone = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    try:
        done = subprocess.run(
            command,
            env={**os.environ, **alone},
            capture_output=True,
            text=True,
            check=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (limit, limit)),
        )
        simulated, taken = map(float, done.stdout.split()[-2:])
    except subprocess.CalledProcessError as error:
        is_over = -error.returncode in (signal.SIGKILL, signal.SIGXCPU)
        ended = f"more than {limit} CPU-s" if is_over else f"ended with {error.returncode}"
        reason = (error.stderr.strip().splitlines() or [ended])[-1]
    except ValueError:
        reason = f"printed {done.stdout!r}"
    else:
        return simulated, taken
    print(f"{' '.join(map(str, command))}: {reason}", file=sys.stderr, flush=True)
    return None


def cell(own: Sequence[Sample | None], other: Sequence[Sample | None]) -> str:
    """The median speed, and its ratio to `own` of the same round with least and greatest.

    `own`, `other`: a sample for each round; None where a program failed. `cell([(2, 1), (2, 1)],
    [(4, 1), (8, 1)]) == "6 (3 x, 2 to 4)"`. "-" without a sample.
    """
    speeds = [one[0] / one[1] for one in other if one is not None]
    if not speeds:
        return "-"
    ratios = [
        (b[0] / b[1]) / (a[0] / a[1])
        for a, b in zip(own, other, strict=True)
        if a is not None and b is not None
    ]
    speed = f"{_rounded(float(np.median(speeds)))}"
    if not ratios or own is other:
        least = _rounded(min(speeds))
        most = _rounded(max(speeds))
        return f"{speed} ({least} to {most})"
    middle, least, most = (
        _rounded(float(value)) for value in np.percentile(ratios, [50.0, 0.0, 100.0])
    )
    return f"{speed} ({middle} x, {least} to {most})"


def _rounded(value: float) -> str:
    """Two digits, or three from 1 to 2: 12,000; 0.045; 1.53."""
    digits = 3 if f"{value:e}"[0] == "1" else 2
    return f"{float(f'{value:.{digits}g}'):,.10g}"


def measured(
    simulators: Sequence[Simulator],
    found: dict[str, Command],
    sizes: Sequence[int],
    rays: Sequence[int],
    rounds: int,
    seconds: float,
) -> dict[tuple[str, int, int], list[Sample | None]]:
    """The samples of each cell (name, robots, rays) by round.

    A cell that failed is not repeated, nor tried with more robots or rays.
    """
    samples: dict[tuple[str, int, int], list[Sample | None]] = {}
    for number in range(rounds):
        print(f"round {number + 1} of {rounds}", file=sys.stderr, flush=True)
        for robots in sizes:
            for count in rays:
                for one in simulators:
                    if one.name not in found or count not in one.rays:
                        continue
                    of_cell = samples.setdefault((one.name, robots, count), [])
                    has_failed = any(
                        None in found_before
                        for (name, fewer, less), found_before in samples.items()
                        if name == one.name and fewer <= robots and less <= count
                    )
                    words = (robots, count, RANGES[count], NEAR, seconds)
                    command = (*found[one.name], *map(str, words), *one.words)
                    of_cell.append(None if has_failed else sample(command))
    return samples


def tables(
    simulators: Sequence[Simulator],
    samples: dict[tuple[str, int, int], list[Sample | None]],
    sizes: Sequence[int],
    rays: Sequence[int],
) -> Iterator[str]:
    """A table for each number of rays, then what each simulator computes."""
    names = {name for name, _, _ in samples}
    for count in rays:
        rows = [[f"{count} rays of {RANGES[count]:g} m", *(f"{robots} robots" for robots in sizes)]]
        for one in simulators:
            if one.name in names and count in one.rays:
                of_row = [
                    cell(samples[OWN, robots, count], samples[one.name, robots, count])
                    for robots in sizes
                ]
                rows.append([one.name, *of_row])
        yield markdown(rows)
    rows = [["simulator", "what a step of it computes"]]
    rows += [[one.name, one.computes] for one in simulators if one.name in names]
    yield markdown(rows)


def learning_table(python: Command | None, rounds: int, seconds: float) -> str:
    """Steps of agents a CPU-second of `swarmd.env` and of tasks of VMAS with random actions."""
    own: dict[tuple[int, str], list[Sample | None]] = {}
    other: dict[tuple[str, int, int], list[Sample | None]] = {}
    for _ in range(rounds):
        for agents in AGENTS:
            for mode in ("barrier", "off"):
                (rate,) = rates(agents, mode, 1)
                own.setdefault((agents, mode), []).append((rate, 1.0))
            for task in TASKS if python else ():
                for count in (1, 32):
                    words = (task, agents, seconds, count)
                    of_cell = other.setdefault((task, agents, count), [])
                    is_over = None in of_cell
                    command = (*(python or ()), *map(str, words))
                    of_cell.append(None if is_over else sample(command))
    rows = [["environment", "rays", *(f"{agents} agents" for agents in AGENTS)]]
    for mode in ("barrier", "off"):
        cells = (cell(own[agents, "barrier"], own[agents, mode]) for agents in AGENTS)
        rows.append([f"swarmd, protection `{mode}`", "360", *cells])
    for task in TASKS if python else ():
        for count in (1, 32):
            cells = (cell(own[agents, "barrier"], other[task, agents, count]) for agents in AGENTS)
            name = f"VMAS {task.partition('_')[0]}, {count} environment{'s' * (count > 1)}"
            rows.append([name, str(VMAS_RAYS.get(task, 12)), *cells])
    return markdown(rows)


def _load() -> str:
    return " ".join(f"{average:.1f}" for average in os.getloadavg())


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.rivals", description=__doc__)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of CPU for a sample")
    parser.add_argument("--sizes", type=int, nargs="*", default=SIZES)
    parser.add_argument("--rays", type=int, nargs="*", default=RAYS, choices=RAYS)
    names = dict.fromkeys(one.name.partition(",")[0] for one in SIMULATORS)
    parser.add_argument("--only", nargs="*", choices=names, help="simulators beside swarmd")
    given = parser.parse_args(arguments)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    chosen = [
        one
        for one in SIMULATORS
        if given.only is None or one.name == OWN or one.name.partition(",")[0] in given.only
    ]
    found, missing = programs(chosen)
    for line in missing:
        print(line, file=sys.stderr, flush=True)
    before = _load()
    samples = measured(chosen, found, given.sizes, given.rays, given.rounds, given.seconds)
    conditions = (
        f"{given.rounds} rounds of samples of {given.seconds:g} CPU-s on one processor, in turn."
        f" Load average (1, 5, 15 min) {before} before, {_load()} after; {machine()}. A ratio is to"
        " the first row in the same round, since the load changes both; then the least and the"
        " greatest ratio."
    )
    blocks = [*tables(chosen, samples, given.sizes, given.rays), *missing, conditions]
    print("\n\n".join(blocks), flush=True)
    python = next((command for name, command in found.items() if name.startswith("VMAS")), None)
    steps = learning_table(python, given.rounds, given.seconds)
    print(f"\n<!-- results: rivals_learning -->\n\n{steps}\n\n{conditions}", flush=True)


if __name__ == "__main__":
    main()
