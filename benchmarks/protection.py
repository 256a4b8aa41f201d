"""Time of protection's decision on a scan of 360 rays, and of a robot's whole step, in a hot loop.

Yardstick: the repulsive field alone, ray by ray in plain Python, as ROS2swarm computes it.
"""

from __future__ import annotations

import os

from swarmd.core.events import (
    TICK_INPUT,
    DriverInput,
    HostInput,
    OdometryInput,
    RequestInput,
    ScanInput,
)

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the daemon

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import cycle

import numpy as np
from msgspec.structs import replace

from benchmarks.steps import in_an_arena, measure
from benchmarks.table import Row, print_table
from swarmd.core.host_messages import Loaded, Step, Stepped
from swarmd.core.messages import Epoch
from swarmd.core.values import Inputs, Odometry, Outputs, Platform, Pose, Scan, Twist
from swarmd.core.verbs import RunRequest
from swarmd.driver_api.hw_codec import decode_scan, encode_scan
from swarmd.pattern_host.wire import decode_command, encode_command
from swarmd.robot.protection.decision import NO_PERMIT, DecisionContext, Permit
from swarmd.robot.protection.settings import Mode
from swarmd.robot.robot import Robot
from swarmd.robot.sensing.conditioning import ScanConditioner
from swarmd.robot.sensors import Sensors
from swarmd.robot.setup import RobotSetup
from swarmd.robot.steering.steering import Steering
from swarmd.settings.settings import load_platform
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.realism import REALISTIC
from swarmd.sim.world.world import World
from swarmd.testing.scans import Disc, scan_of
from tests.support.filter_sim import under_barrier
from tests.support.platforms import with_mode
from tests.support.protection import Commander
from tests.support.robot_harness import moved

MODES: tuple[Mode, ...] = ("barrier", "potential_field", "stop_zone")
REQUESTED = Twist(0.2, 0.1)
PERIOD = 0.2
SCAN_GOAL, MOVING_GOAL = "p99 0.1 ms", "p99 0.2 ms"
DECISION_GOALS = {1: "p50 15 us", 8: "p50 30 us"}
"""By neighbours."""
TURN_SCANS = 32  # of a turn at _TURN rad/s
_TURN = 2.0 * math.pi / (TURN_SCANS * PERIOD)
MOTIONS = {
    "at rest": Twist(),
    "turning with the sweep": Twist(0.1, -_TURN),
    "turning against the sweep": Twist(0.1, _TURN),
}


class LiveRobot:
    """The pure robot, running a pattern that always answers, in simulated time."""

    def __init__(self, platform: Platform) -> None:
        settings = RobotSetup(driver="simulated")
        self.now, self.seq = 0.0, 0
        self.robot = Robot(
            "r", platform, settings, make_steering=Steering, seed=0, instance="b", now=0.0
        )
        self.robot.step(DriverInput(True, ""), self.now)
        self.robot.step(
            RequestInput(
                RunRequest(
                    id="1", operator="bench", targets={"r": Epoch("b", 0)}, pattern="attraction"
                )
            ),
            self.now,
        )
        self.robot.step(HostInput(Loaded(1, 10.0, frozenset(), {})), self.now)

    def advance(self, scan: Scan) -> Scan:
        """Let a scan period pass, with ticks, odometry and answers; the scan, numbered anew."""
        for _ in range(4):
            self.now += PERIOD / 4
            self.robot.step(TICK_INPUT, self.now)
            self.robot.step(OdometryInput(Odometry(self.now, Pose(), REQUESTED)), self.now)
            self.answer()
        self.seq += 1
        return replace(scan, seq=self.seq, stamp=self.now)

    def answer(self) -> None:
        """The pattern host's answer to a step."""
        self.robot.step(HostInput(Stepped(1, Outputs(twist=REQUESTED), self.seq)), self.now)


def live_rows(platform: Platform, scans: Sequence[Scan]) -> Iterator[Row]:
    """Rows of a robot's whole step on a scan: conditioning, protection, bookkeeping."""
    live, some = LiveRobot(platform), cycle(scans)

    def prepare() -> Callable[[], object]:
        scan = live.advance(next(some))
        return lambda: live.robot.step(ScanInput(scan), live.now)

    yield Row("Robot.on_scan", measure_each(prepare), note="all that a scan leads to")
    yield Row("Robot.tick", measure_each(lambda: partial(live.robot.step, TICK_INPUT, live.now)))

    def prepare_answer() -> Callable[[], object]:
        live.robot.step(ScanInput(live.advance(next(some))), live.now)
        return live.answer

    yield Row("Robot.on_host, a step's answer", measure_each(prepare_answer))


def measure_each(prepare: Callable[[], Callable[[], object]]) -> Sequence[float]:
    """Seconds of each call that `prepare` makes; the preparation is not counted."""
    from time import perf_counter_ns

    times = []
    for _ in range(3000):
        call = prepare()
        start = perf_counter_ns()
        call()
        times.append((perf_counter_ns() - start) / 1e9)
    return times[300:]


class Decider:
    """Protection in simulated time: each call is a scan period later."""

    def __init__(self, platform: Platform, scans: Sequence[Scan]) -> None:
        self._protection, self._scans = Commander(platform), cycle(scans)
        self._taken = self._age = 0.0

    def scan(self) -> None:
        """A new scan and a decision."""
        self._taken, self._age = self._taken + PERIOD, 0.0
        self._protection.observe(next(self._scans), self._moment())
        self._decide()

    def requested(self) -> None:
        """A decision on a tick, some time after the last scan, without any cached result."""
        self._age += 1e-5
        self._decide()

    def _decide(self) -> None:
        self._protection.decide(REQUESTED, self._moment(), is_running=True, hold=None)

    def _moment(self) -> DecisionContext:
        now = self._taken + self._age
        return DecisionContext(now, self._age, Odometry(now, Pose(), REQUESTED), 0.0)


def among(
    platform: Platform, neighbors: int, count: int = 100, room: float | None = None
) -> list[Scan]:
    """Scans of that many Waffle Pis in a ring, so near that all of them bind.

    `room`: the side of the room in m; None without walls.
    """
    rng = np.random.default_rng(neighbors)
    scans = []
    for seq in range(count):
        away = rng.uniform(0.42, 0.6, neighbors)
        around = 2.0 * math.pi * (np.arange(neighbors) + rng.uniform()) / max(neighbors, 1)
        discs = [
            Disc(r * math.cos(a), r * math.sin(a), 0.15)
            for r, a in zip(away.tolist(), around.tolist(), strict=True)
        ]
        scans.append(scan_of(platform, discs, room=room, seq=seq, noise=0.01, rng=rng))
    return scans


def in_a_ring(platform: Platform, neighbors: int, twist: Twist) -> list[Scan]:
    """Raw scans of three turns at a twist, in a ring of that many Waffle Pis that are near.

    As in a run: the ring stands, the lidar sweeps while the robot drives, and noise is that of
    `realistic`.
    """
    rng = np.random.default_rng(neighbors)
    radius = twist.linear / twist.angular if twist.angular else 0.0  # of a circle around the middle
    away = rng.uniform(0.42, 0.6, neighbors) + abs(radius)
    around = 2.0 * math.pi * (np.arange(neighbors) + rng.uniform()) / neighbors
    world = World(
        {"": platform} | {str(k): load_platform("waffle_pi") for k in range(neighbors)},
        Arena(4.0, 4.0),
        np.array(
            [
                (0.0, -radius, 0.0),
                *zip(away * np.cos(around), away * np.sin(around), around, strict=True),
            ]
        ),
        realism=REALISTIC,
    )
    world.set_commands(
        np.array([(twist.linear, twist.angular, 0.0), *neighbors * [(0.0, 0.0, 0.0)]])
    )
    scans = []
    for _ in range(4 * TURN_SCANS):
        world.begin_scans(np.array([0]))
        world.step(round(PERIOD / world.dt))
        scans += [scan for _, scan in world.arrived_scans()]
    return scans[-3 * TURN_SCANS :]


class Moving:
    """What a daemon does with the scans of a sweeping sensor while the robot moves at a twist."""

    def __init__(
        self, platform: Platform, scans: Sequence[Scan], twist: Twist, permit: Permit = NO_PERMIT
    ) -> None:
        self._sensors, self._protection = Sensors(platform), Commander(platform)
        self._permit = permit
        self._sensors.on_driver(True, "", 0.0)
        # No ages: those of the platform's sweep count.
        self._scans = cycle([replace(scan, ages=None) for scan in scans])
        self._twist, self._pose, self._seq = twist, Pose(), 0

    def prepare(self) -> Callable[[], object]:
        """Let a scan period pass, with odometry at 20 Hz; the call that takes in the scan."""
        now, self._seq = PERIOD * self._seq, self._seq + 1
        for _ in range(4):
            now += PERIOD / 4
            self._pose = moved(self._pose, self._twist, PERIOD / 4)
            odometry = Odometry(now, self._pose, self._twist)
            self._sensors.on_odometry(odometry, now)
            self._protection.on_odometry(odometry)
        scan = replace(next(self._scans), seq=self._seq, stamp=now - PERIOD)
        return partial(self._take, scan, now)

    def _take(self, raw: Scan, now: float) -> None:
        sensors = self._sensors
        if not sensors.on_scan(raw, now) or sensors.scan is None:
            raise RuntimeError(f"the scan does not count: {sensors.hold(now)}")
        self._protection.observe(sensors.scan, sensors.context(now))
        self._protection.decide(
            REQUESTED, sensors.context(now), True, sensors.hold(now), self._permit
        )


def moving_rows(platform: Platform) -> Iterator[Row]:
    """Scans of the default configuration with conditioning and de-skew, up to the decision."""
    for neighbors in (1, 8):
        for what, twist in MOTIONS.items():
            goal = SCAN_GOAL if what == "at rest" else MOVING_GOAL
            row = f"scan with de-skew and decision, {what}, {neighbors} neighbours"
            yield Row(
                row,
                measure_each(
                    Moving(platform, in_a_ring(platform, neighbors, twist), twist).prepare
                ),
                goal,
            )
    yield from avoidance_rows(platform)


def avoidance_rows(platform: Platform) -> Iterator[Row]:
    """The same in a pattern with recovery beside eight moving robots, in alternation."""
    scans = circling(platform, 8)
    yield from in_alternation(
        {
            f"scan with de-skew and decision, driving, 8 neighbours, {word} avoidance": partial(
                measure_each,
                Moving(
                    platform, scans, Twist(0.02), Permit(may_recover=True, avoids=avoids)
                ).prepare,
            )
            for word, avoids in (("without", False), ("with", True))
        }
    )


def in_alternation(measurements: Mapping[str, Callable[[], Sequence[float]]]) -> Iterator[Row]:
    """A row of each measurement by its name, made three times in turn."""
    times: dict[str, list[float]] = {name: [] for name in measurements}
    for _ in range(3):
        for name, measurement in measurements.items():
            times[name] += measurement()
    yield from map(Row, times, times.values())


def circling(platform: Platform, neighbors: int) -> list[Scan]:
    """Scans of that many Waffle Pis that drive around on a circle of 1 m at 0.2 m/s, for a turn."""
    step = 0.2 * PERIOD
    places = 2.0 * math.pi * np.arange(neighbors) / neighbors
    return [
        scan_of(
            platform,
            [Disc(math.cos(a), math.sin(a), 0.15) for a in seq * step + places],
            seq=seq,
            noise=0.01,
        )
        for seq in range(round(2.0 * math.pi / step))
    ]


def mode_rows(platform: Platform) -> Iterator[Row]:
    """Each mode beside 0 to 8 neighbours."""
    for mode in MODES:
        platform_with_mode = with_mode(platform, mode)
        for neighbors in (0, 1, 2, 4, 8):
            decider = Decider(platform_with_mode, among(platform_with_mode, neighbors))
            what = f"{mode}, {neighbors} neighbours"
            is_barrier = mode == "barrier"
            goal = SCAN_GOAL if is_barrier else "p99 1 ms"
            yield Row(f"scan and decision, {what}", measure(decider.scan), goal)
            goal = DECISION_GOALS.get(neighbors, "") if is_barrier else ""
            yield Row(f"decision alone, {what}", measure(decider.requested), goal)


def wall_rows(platform: Platform) -> Iterator[Row]:
    """A scan and a decision in a room, without and with `walls_stand`, in alternation."""
    standing = under_barrier(platform, walls_stand={"length": 0.5, "seconds": 2.0})
    for neighbors, room in ((8, 2.4), (0, 1.2)):
        scans = among(platform, neighbors, room=room)
        name = f"scan and decision, barrier, {neighbors} neighbours in a room of {room} m"
        yield from in_alternation(
            {
                name + what: partial(measure, Decider(one, scans).scan)
                for what, one in (("", platform), (", walls_stand", standing))
            }
        )


def rows() -> Iterator[Row]:
    platform = load_platform("waffle_pi")
    scans = in_an_arena(platform, 100)
    yield from mode_rows(platform)
    yield from wall_rows(platform)
    yield from moving_rows(load_platform("burger"))
    conditioner = ScanConditioner(platform.scan)
    yield Row(
        "scan conditioned",
        measure(map(lambda scan: conditioner.take(scan, None, 0.0), cycle(scans)).__next__),
    )
    wires = [encode_scan(scan) for scan in scans]
    decode = partial(decode_scan, spec=platform.scan)
    yield Row("scan decoded from the wire", measure(map(decode, cycle(wires)).__next__))
    frames = [Step(1, Inputs(now=0.0, dt=0.1, scan=scan, is_new_scan=True)) for scan in scans]
    yield Row("step encoded for the host", measure(map(encode_command, cycle(frames)).__next__))
    sent = [encode_command(frame) for frame in frames]
    yield Row("step decoded by the host", measure(map(decode_command, cycle(sent)).__next__))
    yield from live_rows(platform, scans)


def main() -> None:
    print_table("Protection and its surroundings, 360 rays, hot", rows())


if __name__ == "__main__":
    main()
