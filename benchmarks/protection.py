"""Protection's decision on a scan of 360 rays, and what surrounds it, in a hot loop.

Yardstick: the repulsive field alone, ray by ray in plain Python, as ROS2swarm computes it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the daemon

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import cycle

from benchmarks.steps import in_an_arena, loop_field, measure
from benchmarks.table import Row, print_table
from swarmd.frames import Ready, Step, Stepped
from swarmd.framing import decode_command, encode_command
from swarmd.messages import Epoch, Request
from swarmd.protection.front import Protection
from swarmd.protection.moment import Moment
from swarmd.robot import Robot
from swarmd.scans import ScanConditioner
from swarmd.sensing import decode_scan, encode_scan
from swarmd.settings import load_platform
from swarmd.status import RobotSettings
from swarmd.values import Inputs, Odometry, Outputs, Platform, Pose, Scan, Twist

WISH = Twist(0.2, 0.1)
PERIOD = 0.2


class LiveRobot:
    """The pure robot, running a pattern that always answers, in simulated time."""

    def __init__(self, platform: Platform) -> None:
        settings = RobotSettings(driver="simulated", layers=lambda name: ())
        self.now, self.seq = 0.0, 0
        self.robot = Robot("r", platform, settings, seed=0, boot="b", now=0.0)
        self.robot.on_driver(True, "", self.now)
        self.robot.on_request(
            Request(
                id="1",
                operator="bench",
                verb="run",
                targets={"r": Epoch("b", 0)},
                args={"pattern": "attraction"},
            ),
            self.now,
        )
        self.robot.on_host(Ready(1, 10.0, frozenset(), {}), self.now)

    def advance(self, scan: Scan) -> Scan:
        """Let a scan period pass, with ticks, odometry and answers; the scan, numbered anew."""
        for _ in range(4):
            self.now += PERIOD / 4
            self.robot.tick(self.now)
            self.robot.on_odometry(Odometry(self.now, Pose(), WISH), self.now)
            self.answer()
        self.seq += 1
        return replace(scan, seq=self.seq, stamp=self.now)

    def answer(self) -> None:
        """What the pattern host says to a step."""
        self.robot.on_host(Stepped(1, Outputs(twist=WISH), self.seq), self.now)


def live_rows(platform: Platform, scans: Sequence[Scan]) -> Iterator[Row]:
    """The whole of a robot's turn: conditioning, protection, bookkeeping."""
    live, some = LiveRobot(platform), cycle(scans)

    def prepare() -> Callable[[], object]:
        scan = live.advance(next(some))
        return lambda: live.robot.on_scan(scan, live.now)

    yield Row("Robot.on_scan", measure_each(prepare), note="all that a scan leads to")
    yield Row("Robot.tick", measure_each(lambda: partial(live.robot.tick, live.now)))

    def prepare_answer() -> Callable[[], object]:
        live.robot.on_scan(live.advance(next(some)), live.now)
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


def rows() -> Iterator[Row]:
    platform = load_platform("waffle_pi")
    scans = in_an_arena(platform, 100)
    loop = measure(map(partial(loop_field, range_max=0.5), cycle(scans)).__next__)
    yield Row("the field ray by ray in plain Python", loop, note="yardstick")
    protection = Protection(platform)

    def decide(scan: Scan) -> None:
        protection.observe(scan, Moment(0.0))
        protection.decide(WISH, Moment(0.0, 0.0), is_running=True, hold=None)

    def again(scan: Scan) -> None:
        protection.decide(WISH, Moment(0.0, 0.0), is_running=True, hold=None)

    conditioner = ScanConditioner(platform.scan)
    yield Row(
        "protection: new scan and decision, potential_field",
        measure(map(decide, cycle(scans)).__next__),
        "p99 1 ms",
    )
    yield Row("protection: decision on a new wish", measure(map(again, cycle(scans)).__next__))
    yield Row(
        "scan conditioned",
        measure(map(lambda scan: conditioner.take(scan, None, 0.0), cycle(scans)).__next__),
    )
    wires = [encode_scan(scan) for scan in scans]
    decode = partial(decode_scan, spec=platform.scan)
    yield Row("scan decoded from the wire", measure(map(decode, cycle(wires)).__next__))
    frames = [Step(1, Inputs(now=0.0, dt=0.1, scan=scan, is_new_scan=True)) for scan in scans]
    encode = partial(encode_command, origins={})
    yield Row("step encoded for the host", measure(map(encode, cycle(frames)).__next__))
    sent = [encode(frame) for frame in frames]
    yield Row("step decoded by the host", measure(map(decode_command, cycle(sent)).__next__))
    yield from live_rows(platform, scans)


def main() -> None:
    print_table("Protection and its surroundings, 360 rays, hot", rows())


if __name__ == "__main__":
    main()
