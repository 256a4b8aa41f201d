"""What `instructions.py` counts: `counted.py LIBRARY FOLDER`, under callgrind.

A program by itself, so that it also runs on the code of an earlier commit: PYTHONPATH names the
checkout. What the code cannot do is written to FOLDER/NAME.error, with the reason in a line.
"""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Callable, Iterator
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any

Calls = Iterator[Callable[[], object]]
"""Calls that are counted; what makes the next one is not."""

REPEATS = 20
"""Calls of a row, of which the mean counts, but for lockstep."""
MANY = 200
"""Calls of a cheap row, so that what happens once in a process (800 instructions a call of 20, as
memory is asked for) counts little."""


class Counter:
    """Counts the instructions of calls; callgrind writes them beside the name of their row.

    `library`: the requests to callgrind, see `instructions.py`.
    """

    def __init__(self, library: Path) -> None:
        self._callgrind = ctypes.CDLL(str(library))

    def count(self, name: str, calls: Calls, repeats: int) -> None:
        """Count that many calls, after two that are not counted."""
        for _ in range(2):
            next(calls)()
        begin = self._callgrind.begin
        end = self._callgrind.end
        self._callgrind.start()
        for _ in range(repeats):
            call = next(calls)
            begin()
            call()
            end()
        self._callgrind.dump(f"{name} / {repeats}".encode())


def rows() -> dict[str, Callable[[], tuple[Calls, int]]]:
    """By name, what makes the calls of a row and their number."""
    return {
        "scan and decision, 8 neighbours": lambda: (repeat(_decider().scan), REPEATS),
        "decision between scans, 8 neighbours": lambda: (_requests(), MANY),
        "scan with de-skew and decision, turning, 8 neighbours": lambda: (_turning(), REPEATS),
        "scan of a robot that drives, and all that it leads to": lambda: (_live_scans(), REPEATS),
        "tick of a robot that drives": lambda: (_live_ticks(), REPEATS),
        "LaserScan, 360 rays, read": lambda: (_reads(), MANY),
        "0.1 s of lockstep, 7 robots, attraction": lambda: (_lockstep("paper_exp1_waffle_pi"), 4),
        "0.1 s of lockstep, robots that name each other (kin)": lambda: (
            _lockstep("paper_exp1_hardware_free", {"groups.all.parameters.kin": True}),
            4,
        ),
    }


def _decider() -> Any:
    from benchmarks import protection
    from swarmd.settings.platforms import load_platform

    platform = load_platform("waffle_pi")
    return protection.Decider(platform, protection.among(platform, 8, 30))


def _requests() -> Calls:
    decider = _decider()
    decider.scan()
    return repeat(decider.requested)


def _turning() -> Calls:
    from benchmarks import protection
    from swarmd.settings.platforms import load_platform

    platform = load_platform("burger")
    twist = protection.MOTIONS["turning with the sweep"]
    moving = protection.Moving(platform, protection.in_a_ring(platform, 8, twist), twist)
    while True:
        yield moving.prepare()


def _live_robot() -> tuple[Any, Iterator[Any]]:
    """A robot that drives, and its scans, each of which comes after all else of its period."""
    from benchmarks import protection
    from swarmd.settings.platforms import load_platform

    platform = load_platform("waffle_pi")
    live = protection.LiveRobot(platform)
    scans = protection.among(platform, 4, 30)
    return live, (live.advance(scans[k % len(scans)]) for k in range(sys.maxsize))


def _live_scans() -> Calls:
    from swarmd.core.events import ScanInput

    live, scans = _live_robot()
    for scan in scans:
        yield partial(live.robot.step, ScanInput(scan), live.now)


def _live_ticks() -> Calls:
    from swarmd.core.events import TICK_INPUT, ScanInput

    live, scans = _live_robot()
    for scan in scans:
        live.robot.step(ScanInput(scan), live.now)
        yield partial(live.robot.step, TICK_INPUT, live.now + 0.01)


def _reads() -> Calls:
    from benchmarks import cdr as messages_of
    from swarmd.drivers.ros import cdr, messages

    payload = cdr.encode(messages_of.scan())
    return repeat(partial(cdr.decode, messages.LaserScan, payload))


def _lockstep(name: str, overrides: Any = None) -> Calls:
    """Parts of 0.1 s, of which every second has scans, from 2 s on."""
    from swarmd.sim.lockstep.lockstep import Lockstep
    from swarmd.sim.scenarios.scenariofile import load_scenario

    run = Lockstep(load_scenario(name, overrides or {}), seed=0)
    run.advance(2.0)
    return repeat(partial(run.advance, 0.1))


def main(library: Path, folder: Path) -> None:
    """Count all rows."""
    counter = Counter(library)
    for name, make in rows().items():
        try:
            calls, repeats = make()
            gc.collect()
            gc.disable()
            counter.count(name, calls, repeats)
        except Exception as error:  # of an earlier commit, which has other names
            (folder / f"{name.replace('/', ' ')}.error").write_text(f"{error!r}\n")
        finally:
            gc.enable()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
