"""Plays records of lockstep runs through `Kin`, and counts right and wrong names by the truth.

A sight is a robot or a pillar within REACH of the lidar of another robot, with a free line between
both, at the time of a scan, after the first START s. The radio loses a tenth of the messages and
delays the rest by 0.1 s; the clocks of the robots are an hour apart.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from swarmd.core.kin_message import KinMessage
from swarmd.core.values import Array, Neighbor, Odometry, Scan
from swarmd.robot.kin.kin import NO_ROBOT, Kin
from swarmd.robot.protection.decision import DecisionContext
from swarmd.robot.steering.tracks import Tracker
from swarmd.settings.platforms import load_platform
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenario import Scenario

REACH = 2.5  # m, of the tracks
START = 10.0  # s
MIDDLE = -0.0555  # m, of a Waffle Pi's footprint ahead of its axle
_HOUR = 3600.0
_LOSS, _DELAY = 0.1, 0.1
_PERIOD = 0.05  # s, in which a run is polled
_RADIUS = 0.15  # m, of what hides others
_SAME = 0.3  # m between a track and what it shows at most


@dataclass
class Poll:
    """What one robot knew at one instant: its newest reading, its age, and a new scan."""

    now: float
    odometry: Odometry | None
    odometry_age: float
    scan: Scan | None
    scan_at: float
    scan_delay: float


@dataclass
class Record:
    """The inputs of all robots of a run, and the truth at the same instants."""

    ids: tuple[str, ...]
    polls: list[list[Poll]]  # of each robot
    truth: list[Array]  # (n, 3)
    pillars: tuple[tuple[float, float, float], ...]  # x, y, radius


def record(scenario: Scenario, seed: int) -> Record:
    """Simulate a run, and record the inputs of its robots."""
    run = Lockstep(scenario, seed)
    pillars = tuple((pole.x, pole.y, pole.radius) for pole in scenario.arena.poles)
    made = Record(tuple(run.world.ids), [[] for _ in run.world.ids], [], pillars)
    newest: list[Scan | None] = [None] * len(made.ids)
    while run.world.time < scenario.duration - 1e-9:
        run.advance(_PERIOD)
        now = run.world.time
        made.truth.append(run.world.poses())
        for row, shell in enumerate(run.shells):
            assert shell is not None
            sensors = shell.robot._sensors
            scan = None if sensors.scan is newest[row] else sensors.scan
            newest[row] = sensors.scan
            age = sensors.odometry_age(now) or 0.0
            made.polls[row].append(
                Poll(now, sensors.odometry, age, scan, sensors._scan_at, sensors.scan_delay.added)
            )
    return made


@dataclass
class Counts:
    """What was counted; errors in m and rad."""

    sights: int = 0
    tracked: int = 0
    named: int = 0
    right: int = 0
    pillars: int = 0
    pillars_named: int = 0
    cleared: int = 0  # pillars that are no robot
    robots_cleared: int = 0
    strays: int = 0  # names of tracks that show neither a robot nor a pillar
    distance: list[float] = field(default_factory=list)
    bearing: list[float] = field(default_factory=list)
    heading: list[float] = field(default_factory=list)

    def row(self) -> str:
        """A row of a table."""
        cells = [
            f"{self.named / max(self.sights, 1):.1%} of {self.sights}",
            f"{self.named / max(self.tracked, 1):.1%}",
            f"{self.right / max(self.named, 1):.2%}",
            f"{self.pillars_named / max(self.pillars, 1):.2%} of {self.pillars}",
            f"{self.cleared / max(self.pillars, 1):.1%} / {self.robots_cleared}",
        ]
        for errors, unit in ((self.distance, 100.0), (self.bearing, 57.3), (self.heading, 57.3)):
            median, most = np.percentile(errors or [math.nan], (50, 95)) * unit
            cells.append(f"{median:.1f} / {most:.1f}")
        return " | ".join(cells)


def play(
    made: Record,
    counts: Counts,
    seed: int,
    make: Callable[[float], Kin] = Kin,
    change: Callable[[KinMessage], KinMessage] = lambda told: told,
    counted: Callable[[int, int], bool] = lambda viewer, seen: True,
) -> list[Kin]:
    """Play a record, and add to `counts`.

    `change`: of each message before it is sent. `counted`: which pairs of robots are counted.
    """
    platform = load_platform("waffle_pi")
    n = len(made.ids)
    rng = np.random.default_rng(seed)
    trackers = [Tracker(platform) for _ in range(n)]
    kins = [make(MIDDLE) for _ in made.ids]
    air: list[tuple[float, int, int, int, KinMessage]] = []
    for instant, truth in enumerate(made.truth):
        for row in range(n):
            poll = made.polls[row][instant]
            clock = _HOUR * row
            if poll.odometry is None:
                continue
            trackers[row].on_odometry(poll.odometry)
            kins[row].on_odometry(poll.odometry, poll.now - poll.odometry_age + clock)
            if poll.scan is None:
                continue
            late = poll.now - poll.scan_at
            trackers[row].observe(
                poll.scan,
                DecisionContext(
                    poll.scan_at,
                    odometry_age=poll.odometry_age - late,
                    scan_delay=poll.scan_delay,
                ),
            )
            around = trackers[row].surroundings(
                DecisionContext(poll.now, odometry_age=poll.odometry_age)
            )
            tracks = [(track.id, track.x, track.y) for track in around.tracks]
            kins[row].observe(around.tracks, poll.scan, poll.now + clock)
            told = kins[row].next_message(poll.now + clock, True, False)
            for other in range(n):
                if other != row and told is not None and rng.random() >= _LOSS:
                    heapq.heappush(air, (poll.now + _DELAY, len(air), row, other, change(told)))
            if poll.now > START:
                _count(made, row, truth, kins[row], poll, tracks, counts, counted)
        now = made.polls[0][instant].now
        while air and air[0][0] <= now:
            _, _, row, other, told = heapq.heappop(air)
            kins[other].on_message(made.ids[row], told, now + _HOUR * other)
    return kins


def _count(
    made: Record,
    row: int,
    truth: Array,
    kin: Kin,
    poll: Poll,
    tracks: list[tuple[int, float, float]],
    counts: Counts,
    counted: Callable[[int, int], bool],
) -> None:
    names = kin.names(poll.now + _HOUR * row)
    plain = tuple(Neighbor(id, 0.0) for id in made.ids)
    peers = {peer.id: peer for peer in kin.complete(plain, poll.now + _HOUR * row)}
    middles = truth[:, :2] + MIDDLE * np.stack([np.cos(truth[:, 2]), np.sin(truth[:, 2])], 1)
    bodies = [(*middles[k], _RADIUS) for k in range(len(middles)) if k != row] + [*made.pillars]
    which = [k for k in range(len(middles)) if k != row]
    x, y, yaw = truth[row]
    own = middles[row]
    shown: dict[int, int] = {}  # the nearest body of each track
    for id, ahead, left in tracks:
        tx = x + math.cos(yaw) * ahead - math.sin(yaw) * left
        ty = y + math.sin(yaw) * ahead + math.cos(yaw) * left
        far = [math.hypot(tx - b[0], ty - b[1]) for b in bodies]
        shown[id] = int(np.argmin(far)) if min(far) < _SAME else -1
        counts.strays += shown[id] < 0 and bool(names[id])
    for index, body in enumerate(bodies):
        if not _is_free(own, index, bodies):
            continue
        mine = [names[id] for id, shows in shown.items() if shows == index]
        if index >= len(which):
            counts.pillars += 1
            counts.pillars_named += any(mine)
            counts.cleared += NO_ROBOT in mine
            continue
        if not counted(row, which[index]):
            continue
        counts.sights += 1
        counts.tracked += bool(mine)
        counts.robots_cleared += NO_ROBOT in mine
        name = next((name for name in mine if name), None)
        if name is None:
            continue
        counts.named += 1
        counts.right += name == made.ids[which[index]]
        if name == made.ids[which[index]]:
            peer, dx, dy = peers[name], body[0] - x, body[1] - y
            assert peer.distance is not None
            assert peer.bearing is not None
            assert peer.heading is not None
            counts.distance.append(abs(peer.distance - math.hypot(dx, dy)))
            turn = math.atan2(dy, dx) - yaw - peer.bearing
            counts.bearing.append(abs(math.remainder(turn, math.tau)))
            turn = truth[which[index]][2] - yaw - peer.heading
            counts.heading.append(abs(math.remainder(turn, math.tau)))


def _is_free(own: Array, index: int, bodies: list[tuple[float, float, float]]) -> bool:
    """True if a body is within reach and no nearer body hides its middle."""
    bx, by, _ = bodies[index]
    distance = math.hypot(bx - own[0], by - own[1])
    bearing = math.atan2(by - own[1], bx - own[0])
    for k, (x, y, radius) in enumerate(bodies):
        near = math.hypot(x - own[0], y - own[1])
        if k != index and near < distance:
            aside = math.remainder(math.atan2(y - own[1], x - own[0]) - bearing, math.tau)
            if abs(aside) < math.asin(min(1.0, radius / near)):
                return False
    return distance <= REACH
