"""The course of the study: inject each fault while the chain drives, and measure the effects."""

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
"""Speed in m/s above which a robot drives."""
FREE = 1.8
"""Length in m of the free corridor ahead of a robot when a fault is injected: with some faults a
base drives on blindly."""
ASIDE = 0.4
"""Half of the corridor's width in m."""
STARTS = tuple((x, y, 0.0) for y in (-2.0, -1.0, 0.0, 1.0, 2.0) for x in (-2.0, 0.0))
"""Poses in m and rad to which robots are carried: the first with a free corridor."""
PATIENCE = 20.0
"""Seconds of a wait for robots to drive with a free corridor."""
START_ATTEMPTS = 5
"""The number of such waits."""
MEND_CAP = 15.0
"""Seconds of a wait for repaired robots to drive."""
SETTLED = 1.0
"""Seconds for which a repaired chain is watched before the robots run again."""
ON_ITS_WAY = 0.1
"""Seconds that a command may take to a base while its robot acknowledges a stop."""

_USUAL = (None, Reason.PROTECTION, Reason.NO_REQUESTED_COMMAND)
_CARRIED = "its pose jumped by"
"""What a driver says for 30 s after `_carry`, which is no report of a fault."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """The measurements of one fault. Times in s from the begin of the fault; inf: never."""

    fault: Fault
    noticed: float  # first report of the fault by a daemon or a peer
    says: str  # text of that report
    commanded: float  # last command of swarmd to move that a base took before the order
    stood: float  # last motion of a body
    driven: Sequence[float]  # m that each body moved until the next run
    code: int  # exit code of the order
    taken: float  # s, duration of the order
    answer: str  # the first robot's answer to the order
    late: int  # commands to move after the acknowledgement of the order, until the next run
    again: float  # s from the repair until all robots drive
    needs_more: bool  # `mend` of the fault was not enough
    others: str  # reports of robots that the fault does not concern

    @property
    def is_late(self) -> bool:
        """True if a base took a command to move after the bound or after the order."""
        return self.commanded > self.fault.bound or self.late > 0


def play(chain: Chain, fault: Fault) -> Row:
    """Inject a fault into a chain that drives, give the order, repair the chain, and run again."""
    make_drive(chain, fault.robots, fault.wall)
    # 1. The fault.
    begun = time.monotonic()
    fault.inject(chain)
    begun = time.monotonic() if fault.begins_later else begun
    looking = _Looking(chain, fault)
    time.sleep(max(0.0, begun + fault.lasts - time.monotonic()))
    # 2. The order.
    ordered = time.monotonic()
    code, taken, output = chain.swarmctl(fault.order, *fault.robots)
    acknowledged = time.monotonic()
    time.sleep(fault.stays)
    told = [*looking.end(), *(_noticed(chain, robot, begun, ordered) for robot in fault.robots)]
    others = {
        robot: _noticed(chain, robot, begun, ordered)[1] for robot in set(ROBOTS) - {*fault.robots}
    }
    # 3. The repair, then the measurements before the robots run again.
    fault.mend(chain)
    mended = time.monotonic()
    time.sleep(SETTLED)
    bodies = (*fault.robots, *fault.bodies)
    moving = [at for body in bodies for at in chain.moving_commands(body, begun, ordered)]
    late = [at for body in bodies for at in chain.moving_commands(body, acknowledged + ON_ITS_WAY)]
    stood = max(chain.standing(body, begun) for body in bodies)
    driven = [chain.path(body, begun) for body in bodies]
    # 4. The next run.
    is_mended = _drive_again(chain, fault.robots)
    needs_more = not is_mended and fault.mend_more is not None
    if not is_mended and fault.mend_more is not None:
        fault.mend_more(chain)
        is_mended = _drive_again(chain, fault.robots)
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


def _drive_again(chain: Chain, robots: Sequence[str]) -> bool:
    """Carry robots without a free corridor to one; True once each has driven, within MEND_CAP s.

    A robot that is carried may lose its returns from one scan to the next, and counts its lidar as
    covered. Its daemon is started again.
    """
    carried = {robot for robot in robots if not _is_covered(chain, robot) and _carry(chain, robot)}
    left = set(robots)

    def have_driven() -> bool:
        for robot in [robot for robot in carried if _is_covered(chain, robot)]:
            carried.remove(robot)
            chain.restart_daemon(robot)
        left.difference_update([robot for robot in left if _drives(chain, (robot,))])
        return not left

    return wait(have_driven, MEND_CAP) < math.inf


def _is_covered(chain: Chain, robot: str) -> bool:
    """Whether a robot counts its lidar, or a part of it, as covered."""
    status = chain.status(robot)
    return status is not None and status.reason is Reason.INVALID_SCAN


def make_drive(chain: Chain, robots: Sequence[str], wall: float = math.inf) -> None:
    """Run the pattern on all robots, until `robots` drive at once, each with a free corridor.

    Each of `robots` is then at most `wall` m from the nearest wall.

    After a wait of PATIENCE s without success, `robots` are carried to free corridors, and the
    bridge is restarted if a driver has a fault: a bridge may forget nodes some time after a crash.
    AssertionError after START_ATTEMPTS waits.
    """

    def is_well() -> bool:
        return all(_driver(chain.status(robot)) == chain.usual for robot in ROBOTS)

    def is_ready() -> bool:
        free = all(_is_free(chain, robot, wall=wall) for robot in robots)
        has_delays = all(_has_delay(chain.status(robot)) for robot in robots)
        return _drives(chain, robots) and is_well() and free and has_delays

    for robot in ROBOTS:
        chain.run(robot)
    for _ in range(START_ATTEMPTS):
        if wait(is_ready, PATIENCE) < math.inf:
            return
        for robot in robots:
            _carry(chain, robot, wall)
            if chain.speed(robot) < MOVING:
                chain.restart_daemon(robot)
        if not is_well():
            chain.restart_bridge()
    raise AssertionError(chain.describe())


def _has_delay(status: Status | None) -> bool:
    """Whether the daemon has measured the delay of scans by their stamps, which takes seconds."""
    delay = None if status is None else status.scan_delay
    return delay is not None and any(
        figure.method == "stamps" and figure.delay is not None for figure in delay.figures
    )


def _drives(chain: Chain, robots: Sequence[str]) -> bool:
    """Whether all of `robots` run and drive; requests a run of each robot that does not run.

    A base behind a bridge that was frozen may still drive by an old command.
    """
    statuses = {robot: chain.status(robot) for robot in robots}
    for robot, status in statuses.items():
        if status is None or status.state is not State.RUNNING:
            chain.run(robot)
    is_running = all(
        status is not None and not _fault(status, chain.usual, is_ordered=False)
        for status in statuses.values()
    )
    return is_running and all(chain.speed(robot) > MOVING for robot in robots)


def _carry(chain: Chain, robot: str, wall: float = math.inf) -> bool:
    """Carry a robot to a free corridor, unless it has one already; True if it was carried.

    The corridor begins at most `wall` m from the nearest wall.
    """
    if _is_free(chain, robot, wall=wall):
        return False
    places = (start for start in STARTS if _is_free(chain, robot, start, wall))
    start = next(places, STARTS[0])
    chain.carry(robot, start)
    wait(lambda: math.dist(chain.poses[robot][-1][1:3], start[:2]) < ASIDE, PATIENCE)
    return True


def _is_free(
    chain: Chain,
    robot: str,
    pose: tuple[float, float, float] | None = None,
    wall: float = math.inf,
) -> bool:
    """Whether no wall and no robot is in the corridor ahead of a robot.

    `pose`: where the corridor begins; None: the robot's present pose. `wall`: m, the distance of
    the nearest wall at most.
    """
    x, y, yaw = pose or chain.poses[robot][-1][1:]
    start = np.array((x, y))
    end = start + FREE * np.array((math.cos(yaw), math.sin(yaw)))
    arena = parse_arena(ARENA)
    half = np.array((arena.length, arena.width)) / 2.0
    others = np.array([chain.poses[body][-1][1:3] for body in BODIES if body != robot])
    is_inside = np.abs(end) < half - ASIDE
    is_near = (half - np.abs(start)).min() <= wall
    return bool(is_near and is_inside.all() and (apart(others, start, end) > ASIDE).all())


class _Looking:
    """Calls `look` of a fault in a thread until the first report, which it keeps with its time."""

    def __init__(self, chain: Chain, fault: Fault) -> None:
        self._told: list[tuple[float, str]] = []
        self._chain, self._fault = chain, fault
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def end(self) -> Sequence[tuple[float, str]]:
        """End the thread; the report as [(s of CLOCK_MONOTONIC, text)], or [] without one."""
        self._over.set()
        self._thread.join()
        return self._told

    def _run(self) -> None:
        while not self._told and not self._over.wait(0.1):
            text = self._fault.look(self._chain)
            self._told += [(time.monotonic(), text)] if text else []


def _noticed(chain: Chain, robot: str, since: float, ordered: float) -> tuple[float, str]:
    """When a daemon's status first reported a fault, and its last fault text before the order.

    Without a report before the order: the last text after the order. (inf, "") without any report.
    From `ordered` on, the order decides the state, so only the driver's text counts.
    """
    texts = [
        (at, _fault(status, chain.usual, is_ordered=at >= ordered))
        for at, status in chain.statuses[robot][:]
        if at >= since
    ]
    reports = [(at, text) for at, text in texts if text]
    if not reports:
        return math.inf, ""
    before_order = [text for at, text in reports if at < ordered]
    last_text = before_order[-1] if before_order else reports[-1][1]
    return reports[0][0], last_text


def _fault(status: Status, usual: str, *, is_ordered: bool) -> str:
    """The text of a fault in a status; empty without a fault.

    `usual`: the driver's text without a fault. `is_ordered`: the state follows from the order.
    """
    driver = _driver(status)
    if _CARRIED in driver:
        driver = usual
    is_usual = status.state is State.RUNNING and status.reason in _USUAL
    words = []
    if not is_usual and not is_ordered:
        words.append(f"`{status.state}` (`{status.reason}`)" if status.reason else status.state)
    if driver != usual:
        words.append(driver)
    elif words and status.detail:
        words.append(status.detail)
    return ": ".join(words)


def _answer(output: str, robot: str) -> str:
    """The first words of a robot's answer to an order, such as `commanded zero`."""
    words = rf"^{robot} +(?:applied +)?([^:;\n]+?)(?: *[:;]| +-$|$)"
    match = re.search(words, output, re.MULTILINE)
    return " ".join(match[1].split()) if match else ""


def _driver(status: Status | None) -> str:
    return "" if status is None else status.health.driver


def rows(chain: Chain, faults: Sequence[Fault]) -> Iterator[Row]:
    """Play all faults one after the other, and yield the row of each."""
    for fault in faults:
        yield play(chain, fault)
