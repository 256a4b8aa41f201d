"""Injects faults one after the other while the chain drives, and measures each."""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from studies.ros.chain import Chain, wait
from studies.ros.faults import Fault
from studies.ros.robots import ARENA, BODIES, ROBOTS
from swarmd.core.messages import Reason, State, Status
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.geometry import apart

MOVING = 0.1
"""m/s from which a robot drives."""
FREE = 1.8
"""m ahead of a robot that are free when a fault comes: some faults let a base drive on blindly."""
ASIDE = 0.4
"""m from the middle of a robot's way that are free."""
STARTS = tuple((x, y, 0.0) for y in (-2.0, -1.0, 0.0, 1.0, 2.0) for x in (-2.0, 0.0))
"""Where robots are put down, in m and rad: the first of these with a free way."""
PATIENCE, START_ATTEMPTS, MEND_CAP = 20.0, 5, 15.0
"""Seconds for robots to drive with a free way, how often, and seconds for mended ones to drive."""
SETTLED = 1.0
"""Seconds for which a mended chain is watched before robots are to run again."""
ON_ITS_WAY = 0.1
"""Seconds that a command may be on its way to a base while its robot acknowledges a stop."""

_USUAL = (None, Reason.PROTECTION, Reason.NO_REQUESTED_COMMAND)


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What was seen. Times in s after the fault (inf: never), except `again` after it was mended.

    `commanded`: the last command of swarmd to move that a base took before the order. `late`: how
    many more came from the order's acknowledgement on until the next run. `code`, `taken` and
    `answer`: exit code and duration of the order, and what the first robot answers. `driven`: m of
    each body until the next run. `others`: what robots that the fault does not concern say.
    `needs_more`: `mend` of the fault was not enough.
    """

    fault: Fault
    noticed: float
    says: str
    commanded: float
    stood: float
    driven: Sequence[float]
    code: int
    taken: float
    answer: str
    late: int
    again: float
    needs_more: bool
    others: str

    @property
    def is_late(self) -> bool:
        """A base got a command to move that it must not get."""
        return self.commanded > self.fault.bound or self.late > 0


def play(chain: Chain, fault: Fault) -> Row:
    """Inject a fault into a chain that drives, give the order, mend it, and run again."""
    make_drive(chain, fault.robots)
    begun = time.monotonic()
    fault.inject(chain)
    begun = time.monotonic() if fault.begins_later else begun
    looking = _Looking(chain, fault)
    time.sleep(max(0.0, begun + fault.lasts - time.monotonic()))
    ordered = time.monotonic()
    code, taken, output = chain.swarmctl(fault.order, *fault.robots)
    acknowledged = time.monotonic()
    time.sleep(fault.stays)
    told = [*looking.end(), *(_noticed(chain, robot, begun, ordered) for robot in fault.robots)]
    others = {
        robot: _noticed(chain, robot, begun, ordered)[1] for robot in set(ROBOTS) - {*fault.robots}
    }
    fault.mend(chain)
    mended = time.monotonic()
    time.sleep(SETTLED)
    bodies = (*fault.robots, *fault.bodies)
    moving = [at for body in bodies for at in chain.moving_commands(body, begun, ordered)]
    late = [at for body in bodies for at in chain.moving_commands(body, acknowledged + ON_ITS_WAY)]
    stood = max(chain.standing(body, begun) for body in bodies)
    driven = [chain.path(body, begun) for body in bodies]
    for robot in fault.robots:
        _carry(chain, robot)
    is_mended = wait(lambda: _drives(chain, fault.robots), MEND_CAP) < math.inf
    needs_more = not is_mended and fault.mend_more is not None
    if not is_mended and fault.mend_more is not None:
        fault.mend_more(chain)
        is_mended = wait(lambda: _drives(chain, fault.robots), MEND_CAP) < math.inf
    at, says = min(told, key=lambda noticed: noticed[0])
    return Row(
        fault=fault,
        noticed=at - begun,
        says=says,
        commanded=max(moving, default=begun) - begun,
        stood=stood,
        driven=driven,
        code=code,
        taken=taken,
        answer=_answer(output, fault.robots[0]),
        late=len(late),
        again=time.monotonic() - mended if is_mended else math.inf,
        needs_more=needs_more,
        others="; ".join(f"{robot}: {text}" for robot, text in sorted(others.items()) if text),
    )


def make_drive(chain: Chain, robots: Sequence[str]) -> None:
    """Run the pattern on all robots; AssertionError unless these drive at once, on a free way.

    Where they do not within PATIENCE, robots are carried to a free way, and the bridge is started
    again if it lacks a robot: it forgets nodes some time after a crash.
    """

    def is_well() -> bool:
        return all(_driver(chain.status(robot)) == chain.usual for robot in ROBOTS)

    def is_ready() -> bool:
        free = all(_is_free(chain, robot) for robot in robots)
        has_delays = all(_has_delay(chain.status(robot)) for robot in robots)
        return _drives(chain, robots) and is_well() and free and has_delays

    for robot in ROBOTS:
        chain.run(robot)
    for _ in range(START_ATTEMPTS):
        if wait(is_ready, PATIENCE) < math.inf:
            return
        for robot in robots:
            _carry(chain, robot)
            if chain.speed(robot) < MOVING:
                chain.restart_daemon(robot)
        if not is_well():
            chain.restart_bridge()
    raise AssertionError(chain.describe())


def _has_delay(status: Status | None) -> bool:
    """Whether stamps tell the delay of scans, as they do after some seconds with one clock."""
    delay = None if status is None else status.scan_delay
    return delay is not None and any(
        figure.method == "stamps" and figure.delay is not None for figure in delay.figures
    )


def _drives(chain: Chain, robots: Sequence[str]) -> bool:
    """Whether all of these drive; those that do not run are told to."""
    for robot in robots:
        status = chain.status(robot)
        if status is None or status.state is not State.RUNNING:
            chain.run(robot)
    return all(chain.speed(robot) > MOVING for robot in robots)


def _carry(chain: Chain, robot: str) -> None:
    """Carry a robot to a place with a free way, unless it has one."""
    if _is_free(chain, robot):
        return
    start = next((start for start in STARTS if _is_free(chain, robot, start)), STARTS[0])
    chain.carry(robot, start)
    wait(lambda: math.dist(chain.poses[robot][-1][1:3], start[:2]) < ASIDE, PATIENCE)


def _is_free(chain: Chain, robot: str, pose: tuple[float, float, float] | None = None) -> bool:
    """Whether neither a wall nor another robot is on its next FREE m; from `pose`, if given."""
    x, y, yaw = pose or chain.poses[robot][-1][1:]
    start = np.array((x, y))
    end = start + FREE * np.array((math.cos(yaw), math.sin(yaw)))
    arena = parse_arena(ARENA)
    others = np.array([chain.poses[body][-1][1:3] for body in BODIES if body != robot])
    is_inside = np.abs(end) < np.array((arena.length, arena.width)) / 2.0 - ASIDE
    return bool(is_inside.all() and (apart(others, start, end) > ASIDE).all())


class _Looking:
    """Asks others about the fault until the end: the first answer, with its time."""

    def __init__(self, chain: Chain, fault: Fault) -> None:
        self._told: list[tuple[float, str]] = []
        self._chain, self._fault = chain, fault
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def end(self) -> Sequence[tuple[float, str]]:
        """The answer, if there was one."""
        self._over.set()
        self._thread.join()
        return self._told

    def _run(self) -> None:
        while not self._told and not self._over.wait(0.1):
            text = self._fault.look(self._chain)
            self._told += [(time.monotonic(), text)] if text else []


def _noticed(chain: Chain, robot: str, since: float, ordered: float) -> tuple[float, str]:
    """When a daemon's status first told of a fault, and what it says last; inf and empty: never.

    From `ordered` on its state is that of the order: then only the driver's text counts.
    """
    told = [
        (at, _fault(status, chain.usual, is_ordered=at >= ordered))
        for at, status in chain.statuses[robot][:]
        if at >= since
    ]
    before = [(at, text) for at, text in told if at < ordered]
    first = next((at for at, text in told if text), math.inf)
    some = before if any(text for _, text in before) else told
    return first, next((text for _, text in reversed(some) if text), "")


def _fault(status: Status, usual: str, *, is_ordered: bool) -> str:
    """What a status tells of a fault; empty if nothing."""
    is_usual = status.state is State.RUNNING and status.reason in _USUAL
    words = []
    if not is_usual and not is_ordered:
        words.append(f"`{status.state}` (`{status.reason}`)" if status.reason else status.state)
    if _driver(status) != usual:
        words.append(_driver(status))
    elif words and status.detail:
        words.append(status.detail)
    return ": ".join(words)


def _answer(output: str, robot: str) -> str:
    """The first words of a robot's answer to an order, such as `commanded zero`."""
    words = rf"^{robot} +(?:applied +)?([^:;\n]+?)(?: *[:;]| +-$|$)"
    match = re.search(words, output, re.MULTILINE)
    return match[1] if match else ""


def _driver(status: Status | None) -> str:
    return "" if status is None else status.health.driver


def rows(chain: Chain, faults: Sequence[Fault]) -> Iterator[Row]:
    """All of them, one after the other."""
    for fault in faults:
        yield play(chain, fault)
