"""How late scans arrive, by stamps and by turns."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from swarmd.core.codec import encode
from swarmd.core.messages import ScanDelaySummary
from swarmd.core.values import Array, Odometry, Platform, Pose, Scan, Twist
from swarmd.robot.sensing.delay_by_stamps import delay_by_stamps
from swarmd.robot.sensing.odometry_history import OdometryHistory
from swarmd.robot.sensing.scan_delay import ScanDelay
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import Disc, scan_of

BURGER = load_platform("burger")
SPEC = BURGER.scan
BOUND = SPEC.max_scan_delay
ROOM = (Disc(0.9, 0.4, 0.2), Disc(-0.5, 1.1, 0.1), Disc(-1.0, -0.8, 0.3))
TURN_ERROR = 0.03  # s, what turns may be wrong by


def swinging(time: float) -> float:
    """A heading whose rate changes: up to 1.5 rad/s."""
    return 0.75 * math.sin(2.0 * time)


def steady(time: float) -> float:
    return 0.8 * time


class Rig:
    """A robot on one spot of a room: odometry at 20 Hz, scans at 5 Hz that arrive `delay` s late.

    `delay` gives the mean age of the rays of each scan on arrival; scans are of one instant.
    `lost`: the share of the rays within 30 degrees of ahead that return nothing.
    """

    def __init__(
        self,
        delay: Callable[[int], float],
        *,
        heading: Callable[[float], float] = lambda time: 0.0,
        discs: tuple[Disc, ...] = ROOM,
        room: float | None = 3.0,
        scan_clock: float = 0.0,
        yaw_scale: float = 1.0,
        odometry_lag: Callable[[float], float] = lambda time: 0.0,
        platform: Platform = BURGER,
        lost: float = 0.0,
    ) -> None:
        self.lost = lost
        self.delays, self.time = ScanDelay(platform.scan), 0.0
        self.history = OdometryHistory(self.delays)
        self.delay, self.heading, self.discs, self.room = delay, heading, discs, room
        self.scan_clock, self.yaw_scale, self.odometry_lag = scan_clock, yaw_scale, odometry_lag
        self.platform, self.rng, self.seq = platform, np.random.default_rng(3), 0
        self.odometry_clock = 0.0
        self.coming: list[tuple[float, int, Odometry | Scan]] = []

    def run(self, seconds: float) -> ScanDelay:
        end = self.time + seconds
        for tick in range(round(self.time / 0.05), round(end / 0.05)):
            now = self.time = 0.05 * tick
            yaw = self.yaw_scale * self.heading(now)
            rate = (yaw - self.yaw_scale * self.heading(now - 0.05)) / 0.05
            lag = self.odometry_lag(now)
            stamp, pose = now + self.odometry_clock, Pose(0.0, 0.0, math.remainder(yaw, math.tau))
            odometry = Odometry(stamp, pose, Twist(0.0, rate))
            self.coming.append((now + lag, tick, odometry))
            if tick % 4 == 0:
                scan = msgspec.structs.replace(self.scan(now), stamp=now + self.scan_clock)
                self.coming.append((now + self.delay(self.seq), -1, scan))
            self.deliver(now + 0.049)
        self.time = end
        return self.delays

    def deliver(self, until: float) -> None:
        self.coming.sort(key=lambda item: item[:2])
        while self.coming and self.coming[0][0] <= until:
            at, _, value = self.coming.pop(0)
            if isinstance(value, Odometry):
                self.history.take(value, at)
            else:
                self.delays.on_scan(value, at)

    def scan(self, now: float) -> Scan:
        self.seq += 1
        yaw, spec = self.heading(now), self.platform.scan
        cos, sin = math.cos(yaw), math.sin(yaw)
        ox, oy = spec.offset
        at = Pose(cos * ox - sin * oy - ox, sin * ox + cos * oy - oy, yaw)
        scan = scan_of(self.platform, self.discs, room=self.room, pose=Pose(0, 0, at.yaw),
                       seq=self.seq, noise=0.01, rng=self.rng)  # fmt: skip
        is_ahead = np.cos(scan.bearings) > math.cos(math.radians(30.0))
        scan.ranges[is_ahead & (self.rng.random(len(is_ahead)) < self.lost)] = 0.0
        return scan

    def figure(self, method: str) -> tuple[float | None, str]:
        figures = {one.method: one for one in self.delays.summary(self.time).figures}
        return figures[method].delay, figures[method].text


@pytest.mark.parametrize("late", [0.0, 0.05, 0.1, 0.2])
def test_stamps_of_one_clock_tell_the_delay(late: float) -> None:
    rig = Rig(lambda seq: SPEC.latency + late)
    delays = rig.run(6.0)
    assert rig.figure("stamps")[0] == pytest.approx(SPEC.latency + late)
    assert delays.added == pytest.approx(late, abs=1e-6)
    assert not delays.is_late


def test_scan_in_time_adds_nothing_to_the_declared_latency() -> None:
    assert Rig(lambda seq: SPEC.latency - 0.05).run(6.0).added == 0.0
    assert Rig(lambda seq: SPEC.latency + 0.005).run(6.0).added == 0.0


def test_ages_of_rays_count_from_the_oldest_which_the_stamp_tells() -> None:
    """A sweep of 0.2 s that ends on arrival has a mean age of 0.1 s, which is declared."""
    ages = np.linspace(0.2, 0.0, 360)
    figure = delay_by_stamps(
        [(1.25, 1.0)],
        [(1.2, 1.2)],
        msgspec.structs.replace(Rig(lambda seq: 0.0).scan(0.0), ages=ages),
        SPEC,
    )
    assert figure.delay == pytest.approx(0.15)


def test_jitter_counts_as_delay() -> None:
    """Each third scan is 0.2 s late: all count as that late, but one scan alone for itself."""
    jitter = Rig(lambda seq: SPEC.latency + 0.2 * (seq % 3 == 0)).run(8.0)
    assert jitter.added == pytest.approx(0.2)
    once = Rig(lambda seq: SPEC.latency + 0.15 * (seq == 30))
    seen = {round(once.run(0.05).added, 3) for _ in range(180)}
    assert seen == {0.0, 0.15}
    assert once.delays.added == 0.0


def test_other_clock_of_the_scans_gives_no_figure_and_says_so() -> None:
    for clock in (-1000.0, 0.5, 1e9):
        rig = Rig(lambda seq: SPEC.latency, scan_clock=clock)
        assert rig.run(6.0).added == 0.0
        delay, text = rig.figure("stamps")
        assert delay is None
        assert "clocks" in text


class SweptRig(Rig):
    """Its scans take 0.2 s; they arrive `SPEC.latency` after their oldest ray."""

    def scan(self, now: float) -> Scan:
        scan = super().scan(now)
        return msgspec.structs.replace(scan, ages=np.linspace(0.2, 0.0, len(scan.ranges)))


def test_scans_that_are_stamped_after_their_oldest_ray_say_so() -> None:
    for late, words in ((0.1, "0.1 s or more after their oldest ray"), (0.2, "different clocks")):
        rig = SweptRig(lambda seq: SPEC.latency, scan_clock=late)
        assert rig.run(6.0).added == 0.0
        delay, text = rig.figure("stamps")
        assert delay is None
        assert words in text


def test_clock_that_is_not_real_time_gives_no_figure() -> None:
    """A simulator at 0.8 of real time: stamps fall behind by 0.2 s a second."""
    rig = Rig(lambda seq: SPEC.latency + 0.04 * seq, odometry_lag=lambda time: 0.2 * time)
    rig.run(8.0)
    assert rig.figure("stamps")[0] is None


def test_late_scans_hold_until_they_are_in_time_again() -> None:
    late = {"by": BOUND + 0.05}
    rig = Rig(lambda seq: SPEC.latency + late["by"])
    assert rig.run(6.0).is_late
    late["by"] = 0.9 * BOUND
    assert rig.run(6.0).is_late
    late["by"] = 0.7 * BOUND
    assert not rig.run(6.0).is_late
    late["by"] = 0.9 * BOUND
    assert not rig.run(6.0).is_late


def test_delay_that_grows_beyond_any_bound_stays_late() -> None:
    """What is known to share a clock does not become another clock by being late."""
    assert Rig(lambda seq: 0.1 + 0.15 * max(seq - 20, 0)).run(40.0).is_late


def test_link_that_delays_scans_and_odometry_alike_is_late_for_a_moment_only() -> None:
    """A simulator that stands still for 0.6 s, and never makes up for it."""

    def paused(time: float) -> float:
        return 0.6 if time >= 6.0 else 0.0

    rig = Rig(lambda seq: SPEC.latency + paused(0.2 * (seq - 1)), odometry_lag=paused)
    rig.run(6.0)
    late = [rig.run(0.1).is_late for _ in range(60)]
    assert 0 < sum(late) <= 18
    assert not late[-1]
    assert rig.delays.added == 0.0


def test_stamps_that_go_back_begin_anew() -> None:
    rig = Rig(lambda seq: SPEC.latency + 0.2)
    rig.run(4.0)
    rig.history.take(Odometry(0.5, Pose(), Twist()), rig.time)
    assert rig.figure("stamps")[0] is None


@pytest.mark.parametrize("jump", [-1000.0, -0.6, 0.6, 1000.0])
def test_clock_that_is_set_begins_the_stamps_anew(jump: float) -> None:
    rig = Rig(lambda seq: SPEC.latency + 0.05)
    rig.run(6.0)
    rig.odometry_clock = rig.scan_clock = jump
    rig.run(4.0)
    assert rig.delays.restarts >= 1
    assert rig.figure("stamps")[0] == pytest.approx(SPEC.latency + 0.05, abs=1e-3)
    assert rig.delays.added == pytest.approx(0.05, abs=1e-3)


@pytest.mark.parametrize(("odometry", "scans"), [(1000.0, 0.0), (-1000.0, 0.0), (0.0, -1000.0)])
def test_clock_that_is_set_alone_is_another_clock_and_not_late_for_good(
    odometry: float, scans: float
) -> None:
    """As when the driver of one of them restarts."""
    rig = Rig(lambda seq: SPEC.latency)
    rig.run(6.0)
    rig.odometry_clock, rig.scan_clock = odometry, scans
    delays = rig.run(5.0)
    assert not delays.is_late
    assert delays.restarts == 1
    assert "clocks" in rig.figure("stamps")[1]


@pytest.mark.parametrize("jump", [-1000.0, -0.6, 0.6, 1000.0])
def test_late_scans_are_late_while_a_clock_is_set(jump: float) -> None:
    rig = Rig(lambda seq: SPEC.latency + BOUND + 0.05)
    assert rig.run(6.0).is_late
    rig.odometry_clock = rig.scan_clock = jump
    assert all(rig.run(0.1).is_late for _ in range(60))


@pytest.mark.parametrize(
    ("odometry", "scans", "is_for_good"),
    [(0.0, -5.0, False), (0.0, -3.0, True), (-5.0, -5.0, False), (30.0, 0.0, False)],
)
def test_scans_that_seem_late_because_a_clock_was_set_name_it(
    odometry: float, scans: float, is_for_good: bool
) -> None:
    rig = Rig(lambda seq: SPEC.latency)
    rig.run(6.0)
    rig.odometry_clock, rig.scan_clock = odometry, scans
    seen = {(rig.run(0.1).is_late, rig.delays.is_clock_set) for _ in range(60)}
    assert (True, False) not in seen
    assert rig.delays.is_late is is_for_good
    rig.scan_clock = odometry
    assert not rig.run(6.0).is_late
    assert not rig.delays.is_clock_set


def test_scans_that_were_late_before_a_clock_was_set_stay_late() -> None:
    rig = Rig(lambda seq: SPEC.latency + BOUND + 0.05)
    rig.run(6.0)
    rig.odometry_clock = rig.scan_clock = -5.0
    assert not any(rig.run(0.1).is_clock_set for _ in range(60))


@pytest.mark.parametrize("late", [0.0, 0.1, 0.25])
@pytest.mark.parametrize("scale", [1.0, 0.95, 1.06])
def test_turns_tell_the_delay_where_clocks_differ(late: float, scale: float) -> None:
    rig = Rig(lambda seq: SPEC.latency + late, heading=swinging, scan_clock=77.0, yaw_scale=scale)
    delays = rig.run(15.0)
    delay, _ = rig.figure("turns")
    assert delay == pytest.approx(SPEC.latency + late, abs=TURN_ERROR)
    assert delays.added == (0.0 if late == 0.0 else pytest.approx(late, abs=2 * TURN_ERROR))
    assert delays.added >= 0.9 * late


@pytest.mark.parametrize("lost", [0.3, 1.0])
@pytest.mark.parametrize("late", [0.0, 0.25])
def test_lost_rays_and_a_blind_sector_do_not_change_the_delay_by_turns(
    lost: float, late: float
) -> None:
    """They stay with the sensor while the room turns."""
    swing = lambda time: 0.3 * (math.sin(2.0 * time) + 0.5 * math.sin(3.4 * time))  # noqa: E731
    rig = Rig(lambda seq: SPEC.latency + late, heading=swing, scan_clock=77.0, lost=lost)
    delays = rig.run(20.0)
    assert rig.figure("turns")[0] == pytest.approx(SPEC.latency + late, abs=TURN_ERROR)
    assert delays.added == (0.0 if late == 0.0 else pytest.approx(late, abs=2 * TURN_ERROR))


def test_a_quarter_of_the_scans_measures_turns_once_enough_are_known() -> None:
    rig = Rig(lambda number: 0.1, heading=swinging, scan_clock=100.0)
    known = rig.run(10.0).summary(rig.time).figures[1].samples
    later = rig.run(40.0).summary(rig.time).figures[1].samples
    assert known > 20
    assert 0.5 * 50 < later - known <= 50  # of 200 scans; slow turns tell nothing


def test_figures_can_be_sent() -> None:
    """A numpy number in a status would end the daemon that answers `members`."""
    rig = Rig(lambda seq: SPEC.latency + 0.1, heading=swinging)
    delays = rig.run(15.0)
    assert rig.figure("turns")[0] is not None
    assert encode(delays.summary(rig.time))


def test_constant_rate_of_turn_gives_no_figure() -> None:
    rig = Rig(lambda seq: SPEC.latency + 0.2, heading=steady, scan_clock=77.0)
    assert rig.run(20.0).added == 0.0
    assert rig.figure("turns")[0] is None


@pytest.mark.parametrize(
    ("discs", "room"), [((), None), ((Disc(0.5, 0.1, 5.0),), None)], ids=["empty", "inside"]
)
def test_scene_without_features_gives_no_figure(
    discs: tuple[Disc, ...], room: float | None
) -> None:
    rig = Rig(lambda seq: 0.3, heading=swinging, scan_clock=77.0, discs=discs, room=room)
    assert rig.run(15.0).added == 0.0
    assert rig.figure("turns")[0] is None


def test_things_that_move_by_themselves_do_not_give_a_wrong_figure() -> None:
    """A crowd around a robot that sees nothing else."""
    rig = Rig(lambda seq: SPEC.latency, heading=swinging, scan_clock=77.0, room=None)
    for _ in range(60):
        rig.discs = tuple(
            Disc(math.cos(a) * r, math.sin(a) * r, 0.1)
            for a, r in zip(rig.rng.uniform(0, 6.28, 5), rig.rng.uniform(0.5, 1.5, 5), strict=True)
        )
        rig.run(0.25)
    assert rig.delays.added == 0.0


def test_late_by_turns_ends_after_a_minute_without_turns() -> None:
    late = SPEC.latency + BOUND + 0.15
    rig = Rig(lambda seq: late, heading=swinging, scan_clock=77.0)
    assert rig.run(15.0).is_late
    rig.heading = lambda time: 0.0
    assert rig.run(30.0).is_late
    assert not rig.run(40.0).is_late


def test_few_rays_give_no_turn() -> None:
    few = replace(SPEC, bearings=np.linspace(-0.7, 0.7, 7))
    rig = Rig(lambda seq: 0.1, heading=swinging, platform=replace(BURGER, scan=few))
    rig.run(3.0)
    assert "full turn" in rig.figure("turns")[1]
    assert rig.figure("stamps")[0] == pytest.approx(0.1)


def test_clockwise_rays_turn_the_same_way() -> None:
    clockwise: Array = -SPEC.bearings
    platform = replace(BURGER, scan=replace(SPEC, bearings=clockwise))
    rig = Rig(lambda seq: 0.2, heading=swinging, scan_clock=77.0, platform=platform)
    rig.run(15.0)
    assert rig.figure("turns")[0] == pytest.approx(0.2, abs=TURN_ERROR)


def test_a_clock_that_is_set_far_ahead_leaves_figures_that_a_status_can_tell() -> None:
    """Odometry shows first that the clock was set, as on a computer without one of its own."""
    delay, set_by = ScanDelay(SPEC), 1.7e9
    history = OdometryHistory(delay)
    for tick in range(200):
        now = 0.05 * tick
        clock = set_by if tick >= 190 else 0.0
        history.take(Odometry(now + clock, Pose(), Twist()), now)
        if tick % 4 == 0:
            scan = scan_of(BURGER, ROOM, seq=tick)
            delay.on_scan(msgspec.structs.replace(scan, stamp=now - 0.1), now)
    assert delay.is_late
    summary = delay.summary(10.0)
    assert msgspec.convert(msgspec.to_builtins(summary), ScanDelaySummary) == summary
