"""What the monitor of assumptions says of stops, and of things that come near."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from swarmd.core.values import Odometry, Platform, Pose, Twist
from swarmd.robot.protection.assumption_monitor import MIN_SHARE, AssumptionMonitor, axis_of
from swarmd.robot.protection.decision import DecisionContext, MovedWall
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import empty_scan
from tests.support.examples import part
from tests.support.filter_sim import FilterSim, box, under_barrier
from tests.support.kernel_forms import both_forms, compares_forms, interpreted, long_run
from tests.support.protection import Protection
from tests.support.restless_bases import RestlessBases, noisy

KERNEL = "swarmd.robot.protection.assumption_monitor"
BURGER = under_barrier(load_platform("burger"))
TOP = BURGER.limits.linear
SLIDES = replace(BURGER, limits=structs.replace(BURGER.limits, lateral=TOP))
"""A Burger that also moves sideways."""
Command = Callable[[float], Twist]


def to_and_fro(time: float) -> Twist:
    """Full speed for 1.5 s, then a stop of 1 s, again and again."""
    return Twist(TOP if time % 2.5 < 1.5 else 0.0)


def turns(time: float) -> Twist:
    return Twist(0.0, 2.0 if time % 3.5 < 2.0 else 0.0)


def left_and_right(time: float) -> Twist:
    """Full speed to the left and to the right in turn, with a stop of 1 s after each."""
    sign = 1.0 if time % 5.0 < 2.5 else -1.0
    return Twist(lateral=sign * TOP if time % 2.5 < 1.5 else 0.0)


def driven(
    command: Command,
    braking: Callable[[float], tuple[float, ...]],
    seconds: float = 12.0,
    *,
    rate: float = 20.0,
    lag: float = 0.0,
    slip: float = 0.02,
    push: Command = lambda time: Twist(),
    platform: Platform = BURGER,
    yaw: float = 0.0,
) -> tuple[float, list[str]]:
    """The share left after a ride on a free floor, and the events.

    `braking` by time, of a base that responds after 40 ms: ahead, in turns, and sideways if that
    differs. Odometry comes with `rate` and `lag`; `push` is added to the speed by others. `yaw` is
    that of the start.
    """
    monitor, rng = AssumptionMonitor(platform), np.random.default_rng(1)
    events, coming, line = [], [], [Twist()] * 5
    v = w = u = x = y = 0.0
    for step in range(round(seconds / 0.01)):
        now = 0.01 * step
        if step % 5 == 0:
            events.append(monitor.on_command(command(now)))
            line[-1] = command(now)
        to, line = line[0], [*line[1:], line[-1]]
        b_v, b_w, *others = braking(now)
        b_u = others[0] if others else b_v
        v += min(max(to.linear - v, -0.01 * b_v), 0.01 * (b_v if to.linear < v else 2.5))
        w += min(max(to.angular - w, -0.01 * b_w), 0.01 * (b_w if to.angular < w else 3.2))
        u_rate = 0.01 * (b_u if abs(to.lateral) < abs(u) else 2.5)
        u += min(max(to.lateral - u, -u_rate), u_rate)
        extra = push(now)
        seen = Twist(v + extra.linear, w + extra.angular, u + extra.lateral)
        x += 0.01 * (math.cos(yaw) * seen.linear - math.sin(yaw) * seen.lateral)
        y += 0.01 * (math.sin(yaw) * seen.linear + math.cos(yaw) * seen.lateral)
        yaw += 0.01 * seen.angular
        if step % round(100 / rate) == 0:
            noisy = 1.0 + slip * rng.standard_normal(2)
            measured = Twist(
                seen.linear * noisy[0], seen.angular * noisy[1], seen.lateral * noisy[0]
            )
            coming.append((now + lag, Odometry(now, Pose(x, y, yaw), measured)))
        while coming and coming[0][0] <= now + 1e-9:
            events.append(monitor.on_odometry(coming.pop(0)[1]))
    return monitor.speed_share, [text for text in events if text]


@pytest.mark.parametrize("command", [to_and_fro, turns], ids=["linear", "angular"])
@pytest.mark.parametrize("share", [0.6, 0.4])
def test_weak_brakes_reduce_the_speed_by_their_share(command: Command, share: float) -> None:
    left, events = driven(command, lambda time: (share, 3.0 * share))
    assert left == pytest.approx(share, rel=0.15)
    assert "braked at" in events[0]
    assert f"speed reduced to {left:.0%}" in events[-1]


@pytest.mark.parametrize("yaw", [0.0, 2.2])
@pytest.mark.parametrize("share", [0.6, 0.4])
def test_weak_brakes_sideways_reduce_the_speed_and_are_named(share: float, yaw: float) -> None:
    left, events = driven(left_and_right, lambda time: (1.0, 3.0, share), platform=SLIDES, yaw=yaw)
    assert left == pytest.approx(share, rel=0.15)
    assert [axis_of(text) for text in events] == ["lateral"] * len(events)
    assert "m/s2 sideways in 3 stops, declared 1.00: speed reduced to" in events[0]


@pytest.mark.parametrize("yaw", [0.0, 2.2])
@pytest.mark.parametrize(
    ("command", "braking"),
    [
        (left_and_right, (1.0, 3.0, 1.0)),
        (left_and_right, (0.4, 1.2, 1.0)),  # nothing brakes ahead or turns
        (to_and_fro, (1.0, 3.0, 0.4)),
    ],
)
def test_each_axis_is_judged_by_its_own_stops(
    command: Command, braking: tuple[float, ...], yaw: float
) -> None:
    ride = driven(command, lambda time: braking, 60.0, platform=SLIDES, yaw=yaw)
    assert ride == (1.0, [])


def test_a_base_that_cannot_move_sideways_is_not_judged_sideways() -> None:
    """Such a base has no lateral commands; something may push it."""
    assert driven(left_and_right, lambda time: (1.0, 3.0, 0.4), 60.0) == (1.0, [])


def test_event_tells_the_evidence() -> None:
    """Stops, measured braking with its deviation, and what is declared."""
    _, events = driven(to_and_fro, lambda time: (0.6, 3.0), slip=0.0)
    (found,) = [re.match(r"braked at (\S+) \+- (\S+) m/s2 in 3 stops, declared 1.00", events[0])]
    assert found is not None
    assert float(found[1]) == pytest.approx(0.6, abs=0.03)
    assert 0.0 < float(found[2]) < 0.05


@pytest.mark.evidence
@pytest.mark.parametrize("noise", [1.0, 2.0])
def test_restless_robots_with_brakes_as_declared_raise_no_alarm(noise: float) -> None:
    """50 robot-hours with the simulator's odometry, at its noise and at twice its noise."""
    bases = RestlessBases(BURGER, 15, noise=noisy(noise))
    assert bases.run(12000.0) == []


@pytest.mark.short_rows(1)
@long_run
@pytest.mark.parametrize(
    ("name", "lag"),
    part(
        [("burger", 0.0), ("burger", 0.25)],  # the first to fail with an ALARM that is too low
        [("waffle_pi", 0.25), ("jackal", 0.25), ("waffle_pi", 0.0), ("jackal", 0.0)],
    ),
)
def test_noisy_odometry_and_slightly_weak_brakes_raise_no_alarm(name: str, lag: float) -> None:
    """With 10 % less braking and 5 % of slip; odometry that comes late."""
    platform = under_barrier(load_platform(name))
    bases = RestlessBases(platform, 6, brakes=0.9, noise=noisy(2.5), lag=lag, seed=2)
    assert bases.run(360.0) == []


@long_run
@pytest.mark.parametrize(("delay", "lag", "late"), [(0.05, 0.0, 0), (0.2, 0.0, 6), (0.05, 0.2, 6)])
def test_bases_that_respond_late_are_named_and_not_slowed(
    delay: float, lag: float, late: int
) -> None:
    """Also where odometry alone is late, which looks alike."""
    bases = RestlessBases(BURGER, 6, delay=delay, lag=lag, seed=3)
    assert bases.run(90.0) == []
    texts = [monitor.late for monitor in bases.monitors]
    assert sum("the base responds 0.1" in text or "responds 0.2" in text for text in texts) == late
    assert sum(map(bool, texts)) == late


@pytest.mark.short_rows(1)
@long_run
@pytest.mark.parametrize("noise", [1.0, 2.0])
def test_restless_robots_with_weak_brakes_are_noticed_within_two_minutes(noise: float) -> None:
    bases = RestlessBases(BURGER, 12, brakes=0.7, noise=noisy(noise))
    bases.run(120.0)
    shares = [monitor.speed_share for monitor in bases.monitors]
    assert max(shares) < 0.75
    assert min(shares) > 0.5


def shares_brakes() -> Platform:
    """A base whose tyres alone brake, so that ahead and sideways share 0.8 g."""
    grip = 0.8 * 9.81
    barrier = {**SLIDES.protection["barrier"], "braking_linear": grip}
    return replace(
        SLIDES,
        limits=structs.replace(SLIDES.limits, linear=5.0, lateral=5.0),
        protection={**SLIDES.protection, "barrier": barrier},
    )


@pytest.mark.short_rows(1)
@long_run
@pytest.mark.parametrize("platform", [SLIDES, shares_brakes()], ids=["slides", "shares brakes"])
@pytest.mark.parametrize(("brakes", "noise", "lag"), [(1.0, 2.0, 0.0), (0.9, 2.5, 0.25)])
@pytest.mark.parametrize("seconds", part([200.0], [6000.0]))
def test_restless_bases_that_move_sideways_raise_no_alarm(
    platform: Platform, brakes: float, noise: float, lag: float, seconds: float
) -> None:
    """Nor if a diagonal stop leaves each axis 0.7 of the braking."""
    bases = RestlessBases(platform, 6, brakes=brakes, noise=noisy(noise), lag=lag, seed=2)
    assert bases.run(seconds) == []


@long_run
@pytest.mark.parametrize("noise", [1.0, 2.0])
def test_restless_bases_with_weak_brakes_sideways_are_noticed(noise: float) -> None:
    bases = RestlessBases(SLIDES, 6, sideways=0.7, noise=noisy(noise), styles=("shuttle",))
    alarms = bases.run(60.0)
    assert {(one.row, axis_of(one.text)) for one in alarms} == {(k, "lateral") for k in range(6)}
    assert all(0.5 < monitor.speed_share < 0.75 for monitor in bases.monitors)


@long_run
@pytest.mark.parametrize(
    ("platform", "weak"),
    [(BURGER, {"brakes": 0.6}), (SLIDES, {"sideways": 0.6, "styles": ("shuttle",)})],
    ids=["burger", "sideways"],
)
def test_ended_findings_are_raised_again_if_they_persist(
    platform: Platform, weak: dict[str, Any]
) -> None:
    bases = RestlessBases(platform, 3, **weak)
    bases.run(60.0)
    for monitor in bases.monitors:
        assert any("braked at" in text for text in monitor.findings)
        monitor.forget(monitor.findings)
        assert (monitor.speed_share, monitor.findings) == (1.0, ())
    bases.run(60.0)
    assert all(monitor.speed_share < 0.7 and monitor.findings for monitor in bases.monitors)


@pytest.mark.parametrize("rate", [20.0, 50.0, 5.0])
@pytest.mark.parametrize("lag", [0.0, 0.3])
@pytest.mark.parametrize("command", [to_and_fro, turns], ids=["linear", "angular"])
def test_brakes_as_assumed_are_no_violation(command: Command, rate: float, lag: float) -> None:
    """However rarely or late odometry comes."""
    assert driven(command, lambda time: (1.0, 3.0), 60.0, rate=rate, lag=lag) == (1.0, [])


@pytest.mark.parametrize("yaw", [0.0, -0.5 * math.pi], ids=["ahead", "sideways"])
def test_monitor_goes_on_after_the_clock_of_odometry_was_set_back(yaw: float) -> None:
    """In the middle of a stop. All motion is along x of odometry."""
    monitor, axis = AssumptionMonitor(SLIDES), "lateral" if yaw else "linear"
    for reading in range(20):
        monitor.on_command(Twist(**{axis: TOP}))
        pose = Pose(0.011 * reading, 0.0, yaw)
        monitor.on_odometry(Odometry(100.0 + 0.05 * reading, pose, Twist(**{axis: TOP})))
    monitor.on_command(Twist())
    monitor.on_odometry(Odometry(1.0, Pose(0.3, 0.0, yaw), Twist(**{axis: 0.1})))
    now, x, speed, texts = 1.0, 0.3, 0.0, []
    for tick in range(800):
        wanted = to_and_fro(0.05 * tick).linear
        texts.append(monitor.on_command(Twist(**{axis: wanted})))
        before, speed = speed, speed + min(max(wanted - speed, -0.025), 0.025)
        now, x = now + 0.05, x + 0.025 * (before + speed)
        texts.append(monitor.on_odometry(Odometry(now, Pose(x, 0.0, yaw), Twist(**{axis: speed}))))
    assert any("braked at 0.5" in text for text in texts)


def test_one_weak_stop_is_no_violation_yet() -> None:
    """On a wet patch the robot brakes with a third."""
    share, events = driven(to_and_fro, lambda time: (0.35 if 4.0 < time < 5.0 else 1.0, 3.0), 20.0)
    assert (share, events) == (1.0, [])


@pytest.mark.parametrize("begin", np.arange(0.0, 0.5, 0.05))
def test_push_while_the_robot_brakes_is_no_violation(begin: float) -> None:
    """Another robot pushes it along, up to 0.15 m/s, during a stop."""

    def push(time: float) -> Twist:
        since = time - 4.0 - begin
        return Twist(0.15 * math.sin(math.pi * since / 0.4) if 0.0 < since < 0.4 else 0.0)

    share, events = driven(to_and_fro, lambda time: (1.0, 3.0), 10.0, push=push)
    assert (share, events) == (1.0, [])


def test_gentle_requests_are_no_violation() -> None:
    """A command that falls slowly is no stop, whatever the base could do."""
    ramp = lambda time: Twist(TOP * max(0.0, 1.0 - (time % 3.0) / 2.0))  # noqa: E731
    swing = lambda time: Twist(TOP * math.sin(2.0 * time), 2.0 * math.sin(1.3 * time))  # noqa: E731
    for command in (ramp, swing):
        assert driven(command, lambda time: (1.0, 3.0), 30.0) == (1.0, [])


def test_small_falls_at_speed_are_not_judged() -> None:
    """Odometry is off by a share of the speed, which is much of a small fall."""

    def steps(time: float) -> Twist:
        return Twist(TOP if time % 1.0 < 0.5 else 0.6 * TOP)

    assert driven(steps, lambda time: (1.0, 3.0), 120.0, slip=0.05) == (1.0, [])


def test_another_driver_of_the_base_is_no_violation() -> None:
    """The base does not follow these commands at all."""
    assert driven(to_and_fro, lambda time: (0.0, 0.0), push=lambda time: Twist(0.2)) == (1.0, [])


def approach(
    monitor: AssumptionMonitor, speed: float, begin: float, own: float = 0.0, rate: float = 5.0
) -> list[str]:
    """A thing comes from 2 m to 0.1 m, with scans at `rate`; the robot drives towards it."""
    rng, events, stamp, gap = np.random.default_rng(round(begin)), [], begin, 2.0
    read, period = begin - 1.0, 1.0 / rate
    while gap > 0.1:
        while read <= stamp:
            monitor.on_odometry(Odometry(read, Pose(own * read), Twist(own)))
            read += 0.05
        events.append(monitor.on_scan(stamp, gap + 0.01 * rng.standard_normal()))
        stamp, gap = stamp + period, gap - period * (speed + own)
    return [text for text in events if text]


@pytest.mark.parametrize("own", [0.0, 0.2])
@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0])
@pytest.mark.parametrize("speed", [0.6, 1.5])
def test_two_fast_approaches_reduce_the_speed(own: float, rate: float, speed: float) -> None:
    monitor, share = AssumptionMonitor(BURGER), pytest.approx(max(0.3 / speed, 0.2), rel=0.15)
    assert len(approach(monitor, speed, 0.0, own, rate)) == 1
    assert monitor.speed_share == 1.0
    events = approach(monitor, speed, 20.0, own, rate)
    assert monitor.speed_share == share
    assert "m/s or faster, declared at most 0.30: speed reduced to" in events[-1]
    assert "2 things came at" in monitor.findings[0]
    approach(monitor, 1.1 * speed, 40.0, own, rate)  # the second fastest counts
    assert "3 things came at" in monitor.findings[0]
    assert monitor.speed_share == share


@pytest.mark.parametrize("own", [0.0, 0.2])
@pytest.mark.parametrize("speed", [0.1, 0.3])
@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0])
def test_things_as_fast_as_assumed_are_no_violation(speed: float, own: float, rate: float) -> None:
    monitor = AssumptionMonitor(BURGER)
    for begin in range(0, 2000, 20):
        assert approach(monitor, speed, float(begin), own, rate) == []


def test_a_robot_that_stops_before_what_comes_is_no_violation() -> None:
    """Its late scans still show the gap that it closed itself."""
    monitor, x, gap = AssumptionMonitor(BURGER), 0.0, 1.2
    gaps: list[float] = []
    for tick in range(60):
        own = 0.22 if tick < 20 else 0.0
        x, gap = x + 0.05 * own, gap - 0.05 * (own + 0.3)
        gaps.append(max(gap, 0.01))
        monitor.on_odometry(Odometry(0.05 * tick, Pose(x), Twist(own)))
        if tick >= 8 and tick % 2 == 0:
            assert monitor.on_scan(0.05 * tick, gaps[tick - 8], 0.4) == ""


def test_two_fast_approaches_far_apart_are_no_violation() -> None:
    monitor = AssumptionMonitor(BURGER)
    for begin in (0.0, 1000.0, 2000.0):
        assert len(approach(monitor, 0.6, begin)) == 1
    assert (monitor.speed_share, monitor.findings) == (1.0, ())


def test_walls_are_not_trusted_after_two_that_moved_and_the_robot_keeps_its_speed() -> None:
    monitor = AssumptionMonitor(under_barrier(BURGER, walls_stand={"seconds": 2.0}))
    for stamp in (0.0, 4.0, 601.0):  # the second too soon, the third too late
        assert monitor.on_moved_wall(stamp, MovedWall(3.0, 0.1, 0.25))
        assert monitor.trusts_walls
    assert "moving_wall: 2 walls" in monitor.on_moved_wall(607.0, MovedWall(3.0, 0.1, 0.25))
    assert (monitor.speed_share, len(monitor.findings)) == (1.0, 1)
    assert not monitor.trusts_walls
    monitor.forget(monitor.findings)
    assert monitor.trusts_walls


def test_walls_are_trusted_again_five_minutes_after_the_last_that_moved() -> None:
    monitor = AssumptionMonitor(under_barrier(BURGER, walls_stand={"seconds": 2.0}))
    for stamp in (0.0, 10.0, 12.0):  # the third too soon to count, but it moved
        monitor.on_moved_wall(stamp, MovedWall(3.0, 0.1, 0.25))
    monitor.end_wall_doubt(312.0)
    assert not monitor.trusts_walls
    monitor.end_wall_doubt(312.2)
    assert (monitor.trusts_walls, monitor.findings) == (True, ())
    monitor.on_moved_wall(320.0, MovedWall(3.0, 0.1, 0.25))  # one is no finding
    assert monitor.trusts_walls


def test_the_finding_names_the_second_fastest_wall_within_ten_minutes() -> None:
    monitor = AssumptionMonitor(under_barrier(BURGER, walls_stand={"seconds": 2.0}))
    for stamp, speed, told in (
        (0.0, 0.25, "a wall"),
        (590.0, 0.05, "2 walls moved at 0.05 m/s"),
        (596.0, 0.3, "3 walls moved at 0.25 m/s"),
        (1190.0, 0.05, "3 walls moved at 0.05 m/s"),
    ):
        assert told in monitor.on_moved_wall(stamp, MovedWall(3.0, 0.1, speed))


def test_a_clock_of_scans_that_was_set_back_hides_no_violation() -> None:
    monitor = AssumptionMonitor(under_barrier(BURGER, walls_stand={"seconds": 2.0}))
    for begin in (5000.0, 0.0, 100.0):
        approach(monitor, 0.6, begin)
        monitor.on_moved_wall(begin, MovedWall(3.0, 0.1, 0.25))
    assert len(monitor.findings) == 2


def test_things_that_appear_are_no_violation() -> None:
    """A robot that steps out from behind another, and returns that come and go."""
    monitor, rng = AssumptionMonitor(BURGER), np.random.default_rng(3)
    for k in range(2000):
        assert monitor.on_scan(0.2 * k, float(rng.choice([0.3, 0.6, 0.9]))) == ""


def test_share_has_a_lower_bound() -> None:
    share, _ = driven(to_and_fro, lambda time: (0.15, 0.4), 60.0, slip=0.0)
    assert share == MIN_SHARE


def stopping(platform: Platform, seconds: float, braking: tuple[float, float]) -> FilterSim:
    sim = FilterSim(platform, [box(0.1, 4.0, Pose(30.0))], braking=braking)
    sim.run(to_and_fro, seconds)
    return sim


def test_protection_scales_the_safe_command_and_nothing_else() -> None:
    sim = stopping(BURGER, 12.0, (0.5, 3.0))
    assert len(sim.protection.events) == 1
    run = sim.run(Twist(TOP, 0.5), 2.0)
    decision = run.decisions[-1][1]
    assert decision.speed_share == pytest.approx(0.5, rel=0.1)
    assert decision.safe.linear == pytest.approx(TOP * decision.speed_share)
    assert decision.safe.angular == pytest.approx(0.5 * decision.speed_share)
    assert decision.is_active
    assert decision.requested == Twist(TOP, 0.5)
    assert sim.run(Twist(), 1.0).decisions[-1][1].safe == Twist()


@long_run
def test_weak_brakes_lead_to_no_fault_once_they_are_measured() -> None:
    """A front comes at others_speed; the base brakes with half of what is assumed."""
    platform = under_barrier(BURGER, unseen_extent=0.0)
    front = box(0.2, 3.0, Pose(6.0), velocity=(-0.3, 0.0), begin=20.0)
    sim = FilterSim(platform, [front], braking=(0.5, 1.5))
    run = sim.run(lambda time: to_and_fro(time) if time < 16.0 else Twist(TOP), 45.0)
    assert run.touch is not None
    assert run.touch.speed <= 0.02


def test_other_modes_assume_nothing() -> None:
    protection = Protection(load_platform("thymio"))
    context = DecisionContext(0.0, 0.0, Odometry(0.0, Pose(), Twist(0.1)), 0.0)
    protection.observe(empty_scan(load_platform("thymio"), 0, 0.0), context)
    decision = protection.decide(Twist(0.1), context, is_running=True, hold=None)
    assert decision.speed_share == 1.0


def test_both_axes_are_judged_also_if_they_fail_at_once() -> None:
    kernel = interpreted(KERNEL, because="its axes are fields of C, and take no other class")
    monitor = kernel.AssumptionMonitor(BURGER)

    class Weak:
        """A brake that finds a violation in each stop."""

        declared, braking = 1.0, 0.5

        def __init__(self, evidence: str) -> None:
            self.evidence = evidence
            self.calls: list[float] = []

        def on_command(self, command: float, speed: float, stamp: float) -> bool:
            self.calls.append(command)
            return True

        def on_step(self, begin: float, end: float, way: float) -> bool:
            self.calls.append(way)
            return True

    axes = Weak("linear"), Weak("angular")
    monitor._linear, monitor._angular = axes
    events = [monitor.on_command(Twist(0.1, 0.2))]
    events += [monitor.on_odometry(Odometry(n, Pose(0.1 * n), Twist())) for n in (0.0, 1.0)]
    assert [len(one.calls) for one in axes] == [2, 2]
    assert [("linear" in text, "angular" in text) for text in events if text] == [(True, True)] * 2


@pytest.mark.short_rows(1)
@compares_forms
@pytest.mark.parametrize("axis", ["linear", "lateral"])
def test_compiled_and_interpreted_code_measure_the_same(axis: str) -> None:
    rng = np.random.default_rng(3)
    ones = [kernel.AssumptionMonitor(SLIDES) for kernel in both_forms(KERNEL)]
    moved = speed = wanted = 0.0
    coming = [0.0] * 4  # commands that the base has yet to get
    events = list[list[list[str]]]()
    for step in range(4000):
        if step % 25 == 0:
            wanted = float(rng.choice((0.0, TOP)))
        coming.append(wanted)
        change = coming.pop(0) - speed
        speed += min(max(change, -0.015), 0.1)  # it brakes at a third of what is declared
        moved += 0.05 * speed * float(rng.uniform(0.99, 1.01))
        pose = Pose(0.0, moved) if axis == "lateral" else Pose(moved)
        odometry = Odometry(0.05 * step, pose, Twist(**{axis: speed}))
        command = Twist(**{axis: wanted})
        found = [[one.on_command(command), one.on_odometry(odometry)] for one in ones]
        events.append(found)
    assert all(one == other for one, other in events)
    assert any(text for one, _ in events for text in one)
    assert ones[0].speed_share == pytest.approx(ones[1].speed_share, abs=1e-12)
    assert ones[0].late == ones[1].late != ""


INTERPRETED = interpreted(KERNEL, because="fields and functions of C are read")


def reading(stamp: float, x: float) -> Odometry:
    return Odometry(stamp, Pose(x, 0.0, 0.0), Twist())


@pytest.mark.parametrize("jump", [reading(1.05, 9.0), reading(0.5, 0.0)], ids=["pose", "clock"])
def test_a_jump_of_the_pose_or_of_the_clock_drops_the_scans(jump: Odometry) -> None:
    monitor = INTERPRETED.AssumptionMonitor(BURGER)
    for stamp in (0.9, 1.0):
        monitor.on_odometry(reading(stamp, 0.0))
        monitor.on_scan(stamp, 0.5)
    assert len(monitor._gaps) == 2
    monitor.on_odometry(jump)
    assert len(monitor._gaps) == 0


def test_indices_from_another_memory_are_refused() -> None:
    """Those of a new monitor are right."""
    for field in ("_travel_first", "_travel_end"):
        monitor = INTERPRETED.AssumptionMonitor(BURGER)
        monitor.check_indices()
        for wrong in (-1, 1 << 60):
            setattr(monitor, field, wrong)
            with pytest.raises(ValueError, match=str(wrong)):
                monitor.check_indices()


def test_the_last_of_few_are_all() -> None:
    assert list(INTERPRETED._last(3, 40)) == [0, 1, 2]
    assert list(INTERPRETED._last(5, 2)) == [3, 4]
