"""The ledger: for each robot of each scene a hash of every second, and its last pose."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array
from swarmd.sim.behaviour import hash_of
from swarmd.sim.experiments.pool import worker_functions
from swarmd.sim.experiments.provenance import made_with
from swarmd.sim.trace import Trace

FILE = Path(__file__).with_name("ledger.json")
RENEWAL = "make behaviour"
_DIGITS = 8  # of the hash of a second
_PLACES = 5  # decimals of the last pose, in m and rad
_DECIDING = ("pinned", "functions", "libc", "numpy", "scipy", "mujoco", "machine")
"""The keys of `made_with` that decide bits beside the code, and the series of Python."""


class Drive(msgspec.Struct, frozen=True):
    """How a robot drives in a scene."""

    seconds: str
    """_DIGITS hex digits for each second, without a space."""
    pose: tuple[float | None, float | None, float | None]
    """The last pose: x, y in m, yaw in rad; None outside the arena."""

    @property
    def hashes(self) -> list[str]:
        """The hash of each second."""
        return [self.seconds[at : at + _DIGITS] for at in range(0, len(self.seconds), _DIGITS)]

    def before(self, second: int) -> Drive:
        """The first seconds alone, with the same last pose."""
        return Drive(self.seconds[: second * _DIGITS], self.pose)


Scenes = Mapping[str, Mapping[str, Drive]]
"""By scene and robot."""


class Ledger(msgspec.Struct, frozen=True):
    """How robots drive, and with which software that was found."""

    made_with: dict[str, str]
    scenes: dict[str, dict[str, Drive]]

    def other_software(self) -> str:
        """What differs between the software of the ledger and that of this machine; else empty."""
        here = note()
        differing = [name for name in here if here[name] != self.made_with.get(name)]
        texts = [
            f"{name}: {self.made_with.get(name, 'unknown')}, here {here[name]}"
            for name in differing
        ]
        return ", ".join(texts)


def note() -> dict[str, str]:
    """The software that decides the bits beside the code, as a worker of this machine has it."""
    made = made_with(worker_functions())
    python = ".".join(made["python"].split(".")[:2])  # 3.12 adds numbers in another way
    return {**{name: made[name] for name in _DECIDING}, "python": python}


def drives_of(trace: Trace) -> dict[str, Drive]:
    """How each robot of a trace drives, by its name.

    A second holds poses, requested and safe commands, state, reason, and what the pattern reports.
    """
    return {robot: _drive(trace, row) for row, robot in enumerate(trace.ids)}


def _drive(trace: Trace, row: int) -> Drive:
    hashes = "".join(
        hash_of(trace, _DIGITS, robot=row, instants=instants) for instants in seconds_of(trace.t)
    )
    last = [round(value, _PLACES) + 0.0 for value in trace.pose[-1, row].tolist()]
    x, y, yaw = (None if np.isnan(value) else value for value in last)
    return Drive(hashes, (x, y, yaw))


def seconds_of(t: Array) -> list[NDArray[np.intp]]:
    """The instants of each second: those in (k, k + 1] s are second k; instant 0 is in second 0."""
    number = np.maximum(np.ceil(t - 1e-6).astype(int) - 1, 0)
    return [np.flatnonzero(number == second) for second in range(int(number[-1]) + 1)]


def differences(kept: Scenes, now: Scenes) -> Iterator[tuple[str, str, str]]:
    """Scene, robot and text of each robot that drives otherwise than is kept.

    `kept` may hold more seconds than `now`, which are not compared then. The robot is empty for a
    scene that only one of both has.
    """
    for scene in sorted({*kept, *now}):
        if scene not in kept or scene not in now:
            yield scene, "", "is new" if scene not in kept else "is gone"
            continue
        for robot in sorted({*kept[scene], *now[scene]}):
            was = kept[scene].get(robot)
            drives = now[scene].get(robot)
            if was is None or drives is None:
                yield scene, robot, "is new" if was is None else "is gone"
                continue
            pairs = zip(was.hashes, drives.hashes, strict=False)
            second = next((k for k, (a, b) in enumerate(pairs) if a != b), None)
            if second is not None:
                yield scene, robot, f"drives otherwise from {second} s on"


def described(found: tuple[str, str, str]) -> str:
    """A difference as a line: `flocking: tb3-03 drives otherwise from 4 s on`."""
    scene, robot, text = found
    return f"{scene}: {f'{robot} ' if robot else 'the scene '}{text}"


def by_how_much(kept: Trace, now: Trace, robot: str) -> str:
    """How far apart a robot is at the end of two traces, and its mean speeds, as text."""
    rows = [trace.ids.index(robot) for trace in (kept, now)]
    ends = [trace.pose[-1, row, :2] for trace, row in zip((kept, now), rows, strict=True)]
    apart = float(np.hypot(*(ends[1] - ends[0])))
    speeds = [_mean_speed(trace, row) for trace, row in zip((kept, now), rows, strict=True)]
    return f"{1000.0 * apart:.3g} mm at the end; mean speed {speeds[0]:.3f} -> {speeds[1]:.3f} m/s"


def _mean_speed(trace: Trace, row: int) -> float:
    steps = np.diff(trace.pose[:, row, :2], axis=0)
    return float(np.nansum(np.hypot(*steps.T)) / max(trace.t[-1] - trace.t[0], 1e-9))


def read() -> Ledger:
    """The ledger of the repository; ConfigError if it cannot be read."""
    try:
        return msgspec.json.decode(FILE.read_bytes(), type=Ledger)
    except (OSError, msgspec.MsgspecError) as error:
        raise ConfigError(f"{FILE}: {error}; `{RENEWAL}` writes it again") from error


def write(ledger: Ledger) -> None:
    """Write the ledger, with a line for each robot."""
    scenes = []
    for scene, robots in sorted(ledger.scenes.items()):
        lines = [
            f"    {json.dumps(robot)}: {msgspec.json.encode(drive).decode()}"
            for robot, drive in sorted(robots.items())
        ]
        scenes.append(f"  {json.dumps(scene)}: {{\n" + ",\n".join(lines) + "\n  }")
    made = json.dumps(ledger.made_with, indent=2, sort_keys=True)
    FILE.write_text(f'{{"made_with": {made},\n"scenes": {{\n' + ",\n".join(scenes) + "\n}}\n")
