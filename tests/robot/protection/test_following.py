"""A base that refuses or changes commands is noticed; a base that follows slowly is not."""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Callable
from dataclasses import replace
from random import Random

import pytest
from msgspec import structs

from swarmd.core.values import ZERO, Odometry, Platform, Pose, TouchZone, Twist
from swarmd.robot.protection.decision import DecisionContext, Permit
from swarmd.robot.protection.following import DELAY, MIN_DURATION, WINDOW, FollowingMonitor
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.testing.scans import empty_scan
from tests.support.examples import part
from tests.support.kernel_forms import both_forms, compares_forms, interpreted
from tests.support.protection import Protection
from tests.support.robot_harness import RobotHarness, moved
from tests.support.stub_patterns import PATTERNS

KERNEL = "swarmd.robot.protection.following"
TICK = 0.05

BURGER = load_platform("burger")
Motion = Callable[[float], Twist]


def rides(
    command: Motion,
    moves: Callable[[float, Twist], Twist] = lambda time, twist: twist,
    *,
    seconds: float = 6.0,
    rate: float = 20.0,
    delay: float = 0.04,
    acceleration: tuple[float, float] = (2.5, 3.2),
    platform: Platform = BURGER,
    has_twist: bool = True,
    noise: float = 0.02,
) -> list[tuple[float, str]]:
    """The texts of a ride, each with its time in s.

    The base responds `delay` s late with this acceleration in m/s2 and rad/s2; `moves` gives what
    it does in place of that, by time.
    """
    monitor, chance, found = FollowingMonitor(platform), Random(1), list[tuple[float, str]]()
    line = [ZERO] * max(round(delay / 0.01), 1)
    v = w = u = x = y = yaw = 0.0
    for step in range(round(seconds / 0.01)):
        now = 0.01 * step
        if step % 5 == 0:
            monitor.on_command(command(now))
            line.append(command(now))
        else:
            line.append(line[-1])
        to = line.pop(0)
        v += min(max(to.linear - v, -0.01 * acceleration[0]), 0.01 * acceleration[0])
        w += min(max(to.angular - w, -0.01 * acceleration[1]), 0.01 * acceleration[1])
        u += min(max(to.lateral - u, -0.01 * acceleration[0]), 0.01 * acceleration[0])
        seen = moves(now, Twist(v, w, u))
        ahead, aside = 0.01 * seen.linear, 0.01 * seen.lateral
        x += ahead * math.cos(yaw) - aside * math.sin(yaw)
        y += ahead * math.sin(yaw) + aside * math.cos(yaw)
        yaw = math.remainder(yaw + 0.01 * seen.angular, math.tau)
        if step % round(100 / rate) == 0:
            a, b = (1.0 + noise * chance.gauss(0.0, 1.0) for _ in range(2))
            twist = Twist(seen.linear * a, seen.angular * b, seen.lateral * a)
            twist = twist if has_twist else ZERO
            monitor.on_odometry(Odometry(now, Pose(x, y, yaw), twist))
            if monitor.text:
                found.append((now, monitor.text))
    return found


def ahead(time: float) -> Twist:
    return Twist(0.15)


def turning(time: float) -> Twist:
    return Twist(0.0, 1.0)


def reflex(begin: float, motion: Twist) -> Callable[[float, Twist], Twist]:
    """The base does this for 1.5 s from `begin` on."""
    return lambda time, twist: motion if begin <= time < begin + 1.5 else twist


@pytest.mark.parametrize("command", [ahead, turning])
@pytest.mark.parametrize("share", [0.0, -0.5])
def test_a_base_that_refuses_or_reverses_a_command_is_noticed(
    command: Motion, share: float
) -> None:
    wanted = command(0.0)
    does = Twist(share * wanted.linear, share * wanted.angular)
    found = rides(command, reflex(3.0, does), noise=0.0)
    assert 3.0 + MIN_DURATION - 0.1 <= found[0][0] <= 3.0 + MIN_DURATION + 0.1
    assert found[-1][0] < 4.6  # it follows again


def test_a_base_that_never_starts_is_noticed() -> None:
    found = rides(ahead, lambda time, twist: ZERO)
    assert found[0][0] < 2.5
    assert "commanded 0.15 m/s, moves 0.00 m/s" in found[0][1]


def test_a_base_that_moves_although_zero_is_commanded_is_noticed() -> None:
    found = rides(lambda time: Twist(0.15 if time < 2.0 else 0.0), reflex(4.0, Twist(-0.1)))
    assert 4.6 <= found[0][0] <= 4.9
    assert "commanded 0.00 m/s, moves -0.10 m/s since 0." in found[0][1]


def test_another_node_that_turns_the_base_is_noticed() -> None:
    found = rides(ahead, reflex(3.0, Twist(0.15, 0.8)))
    assert "rad/s" in found[0][1]


def test_an_omnidirectional_base_that_ignores_a_sideways_command_is_noticed() -> None:
    def sideways(time: float) -> Twist:
        return Twist(0.0, 0.3, 0.15)

    slides = replace(BURGER, limits=structs.replace(BURGER.limits, lateral=0.2))
    assert rides(sideways, platform=slides) == []
    found = rides(sideways, reflex(3.0, Twist(0.0, 0.3)), platform=slides, noise=0.0)
    assert 3.0 + MIN_DURATION - 0.1 <= found[0][0] <= 3.0 + MIN_DURATION + 0.1
    assert "commanded 0.15 m/s to the left, moves 0.00 m/s" in found[0][1]


def to_and_fro(time: float) -> Twist:
    return Twist(0.2 if time % 3.0 < 1.5 else -0.2, math.copysign(1.5, math.sin(2.0 * time)))


def restless(time: float) -> Twist:
    chance = Random(round(time / 0.3))
    return Twist(chance.uniform(-0.2, 0.22), chance.uniform(-2.0, 2.0))


def waves(time: float) -> Twist:
    return Twist(0.2 * math.sin(3.0 * time), 2.0 * math.sin(2.0 * time))


@pytest.mark.parametrize("command", [ahead, turning, to_and_fro, restless, waves])
@pytest.mark.parametrize("delay", [0.04, 0.3])
@pytest.mark.parametrize("acceleration", [(0.26, 0.8), (1.0, 3.0), (10.0, 30.0)])
@pytest.mark.parametrize("rate", part([5.0], [50.0]))
def test_a_slow_or_late_base_is_none_that_does_not_follow(
    command: Motion, delay: float, acceleration: tuple[float, float], rate: float
) -> None:
    found = rides(
        command, seconds=30.0, delay=delay, acceleration=acceleration, rate=rate, noise=0.05
    )
    assert not found


@pytest.mark.parametrize("share", [0.6, 1.3])
def test_slip_is_none(share: float) -> None:
    def slips(time: float, twist: Twist) -> Twist:
        return Twist(share * twist.linear, share * twist.angular)

    assert not rides(to_and_fro, slips, seconds=20.0)


def test_creeping_commands_that_friction_eats_are_none() -> None:
    assert not rides(lambda time: Twist(0.04, 0.2), lambda time, twist: ZERO)


def test_odometry_without_a_twist_is_judged_by_its_pose() -> None:
    texts = [text for _, text in rides(to_and_fro, seconds=15.0, has_twist=False)]
    assert all("contradicts itself" in text for text in texts)
    found = rides(ahead, reflex(3.0, Twist(-0.1)), has_twist=False)
    assert any("commanded 0.15 m/s, moves" in text for _, text in found)


def test_a_push_that_is_shorter_than_the_time_is_none() -> None:
    def pushed(time: float, twist: Twist) -> Twist:
        return Twist(-0.2) if 3.0 <= time < 3.0 + MIN_DURATION - 0.15 else twist

    assert not rides(ahead, pushed)


def test_a_robot_that_does_not_run_is_not_judged() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.odometry = Twist(0.3)  # a person pushes it
    harness.advance(5.0)
    assert not harness.status.not_following


@pytest.mark.parametrize(("touch", "is_named"), [(None, True), (TouchZone(0.0, 0.5, 0.1), False)])
def test_what_a_robot_may_touch_may_stop_it(touch: TouchZone | None, is_named: bool) -> None:
    protection = Protection(BURGER)
    for step in range(80):
        now = 0.05 * step
        context = DecisionContext(now, 0.0, Odometry(now, Pose(), ZERO), 0.0)
        protection.observe(empty_scan(BURGER, step, now), context)
        protection.decide(
            Twist(0.1), context, is_running=True, hold=None, permit=Permit(touch=touch)
        )
        protection.on_odometry(Odometry(now, Pose(), ZERO))
    assert bool(protection.following.text) is is_named


def test_the_status_and_one_event_name_it_and_motion_goes_on() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.odometry = Twist(0.2)
    harness.advance(1.0)
    harness.ask("run", pattern="forward")
    harness.advance(2.0)
    assert not harness.status.not_following
    harness.odometry = Twist(-0.05)
    harness.advance(MIN_DURATION + 0.1)
    text = harness.status.not_following
    assert "commanded 0.20 m/s" in text
    assert harness.twist == Twist(0.2)
    assert [one.text for one in harness.status.events].count(text) <= 1
    harness.odometry = Twist(0.2)
    harness.advance(WINDOW)
    assert not harness.status.not_following
    assert sum("follow" in one.text for one in harness.status.events) == 2


@pytest.mark.parametrize("name", platform_names())
def test_every_platform_is_watched(name: str) -> None:
    platform = load_platform(name)
    top = min(platform.limits.linear, 0.5)
    found = rides(lambda time: Twist(top), reflex(8.0, ZERO), seconds=12.0, platform=platform)
    assert found
    assert found[0][0] >= 8.0


def blocked_bearings(
    command: Motion,
    share: Callable[[float], float],
    *,
    seconds: float = 8.0,
    lateral: float = 0.0,
    rate: float = 0.25,
) -> list[tuple[float, float]]:
    """Times at which the base is blocked, with the direction; it moves a share of each command.

    `rate`: m/s^2, the acceleration of the base; by default that of the slow base, a quarter of the
    declared braking.
    """
    platform = replace(BURGER, limits=structs.replace(BURGER.limits, lateral=lateral))
    monitor, found, x, y, v, u = FollowingMonitor(platform), [], 0.0, 0.0, 0.0, 0.0
    for step in range(round(seconds / TICK)):
        now = TICK * step
        v += min(max(command(now).linear - v, -rate * TICK), rate * TICK)
        u += min(max(command(now).lateral - u, -rate * TICK), rate * TICK)
        monitor.on_command(command(now))
        x += TICK * v * share(now)
        y += TICK * u * share(now)
        monitor.on_odometry(Odometry(now, Pose(x, y), Twist(v * share(now), 0.0, u * share(now))))
        if not math.isnan(monitor.blocked_bearing):
            found.append((now, monitor.blocked_bearing))
    return found


def comes_and_goes(time: float) -> Twist:
    return Twist(0.22 if time % 0.9 < 0.6 else 0.02)


@pytest.mark.parametrize(
    ("command", "bearing", "within"),
    [
        (ahead, 0.0, 1.1),
        (comes_and_goes, 0.0, 1.1),
        (lambda time: Twist(-0.15), math.pi, 1.1),
        (lambda time: Twist(0.0, 0.0, -0.15), -0.5 * math.pi, 1.1),
    ],
)
def test_a_base_that_stands_is_blocked_in_the_direction_of_its_command(
    command: Motion, bearing: float, within: float
) -> None:
    found = blocked_bearings(command, lambda time: float(time < 4.0), lateral=0.2)
    assert {direction for _, direction in found} == {bearing}
    assert 4.2 < found[0][0] < 4.0 + within


@pytest.mark.parametrize(
    ("command", "share"),
    [(ahead, 1.0), (ahead, 0.6), (comes_and_goes, 1.0), (lambda time: Twist(0.02), 0.0)],
)
def test_a_slow_base_that_moves_and_one_that_may_creep_are_not_blocked(
    command: Motion, share: float
) -> None:
    assert blocked_bearings(command, lambda time: share) == []


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("rate", [0.25, 0.5, 1.0, 2.5])
@pytest.mark.parametrize("speed", [0.22, 0.5])
def test_a_base_that_reverses_again_and_again_is_not_blocked(
    seed: int, rate: float, speed: float
) -> None:
    """Commands back and forth, each for 0.2 to 2 s, as the paper's equations give.

    Burgers drive 0.22 m/s, and Jackals 0.5 m/s.
    """
    draw, ends, now = Random(seed), list[float](), 0.0
    while now < 30.0:
        now += draw.uniform(0.2, 2.0)
        ends.append(now)

    def command(time: float) -> Twist:
        return Twist(speed * (-1.0) ** bisect(ends, time))

    assert blocked_bearings(command, lambda time: 1.0, seconds=30.0, rate=rate) == []


@pytest.mark.parametrize("back", [0.3, 0.6])
def test_a_base_that_stands_between_reversals_is_blocked_ahead(back: float) -> None:
    def command(time: float) -> Twist:
        return Twist(0.22 if time % 2.5 < 2.5 - back else -0.22)

    found = blocked_bearings(command, lambda time: float(time < 4.0), seconds=12.0, rate=2.5)
    assert found
    assert {bearing for _, bearing in found} == {0.0}


def test_the_slow_base_heads_for_the_command_that_held_then_though_periods_change() -> None:
    kernel = interpreted(KERNEL, because="methods and fields of C are used")
    axis, draw = kernel._Axis(0.05, 0.25, "m/s", 0.15), Random(1)
    given, slow, stamp = [(0.0, 0.0)], 0.0, 0.0
    axis.reset(0.0, stamp)
    for _ in range(2000):
        if draw.random() < 0.5:
            command = draw.choice((0.0, 0.1, 0.2, -0.1))
            axis.on_command(command, stamp)
            if command != given[-1][1]:
                given.append((stamp, command))
        period = draw.choice((0.02, 0.05, 0.3))
        stamp += period
        axis.on_reading(period, stamp, 0.0, 0.0)
        begin = stamp - DELAY - 2.0 * period
        held = [command for at, command in given if at <= begin] or [given[0][1]]
        slow += min(max(held[-1] - slow, -0.25 * period), 0.25 * period)
        assert axis._slow_speed == pytest.approx(slow, abs=1e-9)


Sensor = Callable[[Odometry], Odometry | None]
SLIDES = replace(BURGER, limits=structs.replace(BURGER.limits, lateral=0.2))


def contradictions(
    sensor: Sensor, motion: Motion, *, seconds: float = 30.0, platform: Platform = BURGER
) -> list[tuple[float, str]]:
    """Times and texts of contradictions of a base that follows `motion`, 20 readings a second.

    `sensor` gives the reading for the true odometry (None: it is lost).
    """
    monitor, pose, found = FollowingMonitor(platform), Pose(), list[tuple[float, str]]()
    for step in range(round(seconds / TICK)):
        now = TICK * step
        twist = motion(now)
        pose = moved(pose, twist, TICK)
        monitor.on_command(twist)
        reading = sensor(Odometry(now, pose, twist))
        if reading is not None:
            monitor.on_odometry(reading)
        if "contradicts itself" in monitor.text:
            found.append((now, monitor.text))
    return found


def circle(time: float) -> Twist:
    return Twist(0.2, 0.5)


def in_odometry_frame(one: Odometry) -> Odometry:
    v, yaw = one.twist.linear, one.pose.yaw
    turned = Twist(v * math.cos(yaw), one.twist.angular, v * math.sin(yaw))
    return Odometry(one.stamp, one.pose, turned)


def jumping(period: float) -> Sensor:
    """The pose jumps by 0.35 m to and fro; the first jump comes after `period` s."""
    return lambda one: Odometry(
        one.stamp, Pose(one.pose.x + 0.35 * (int(one.stamp / period) % 2), one.pose.y), one.twist
    )


# Ways in the sums: 5 s times 0.2 m/s or 0.5 rad/s, times (1 - exp(-30 / 5)), so 1.00 m, 2.49 rad.
@pytest.mark.parametrize(
    ("sensor", "motion", "within", "last"),
    [
        pytest.param(
            lambda one: Odometry(one.stamp, one.pose, ZERO),
            ahead,
            2.0,
            "by its pose 0.75, by its twist 0.00 m in",
            id="twist zero",
        ),
        pytest.param(
            lambda one: Odometry(one.stamp, Pose(), one.twist),
            ahead,
            2.0,
            "by its pose 0.00, by its twist 0.75 m in",
            id="pose frozen",
        ),
        pytest.param(in_odometry_frame, circle, 6.0, " m in", id="twist in the frame of odometry"),
        pytest.param(
            lambda one: Odometry(one.stamp, one.pose, Twist(one.twist.linear, -one.twist.angular)),
            turning,
            1.0,
            "by its twist -4.9",
            id="sign of the turn",
        ),
        pytest.param(
            lambda one: Odometry(one.stamp, one.pose, Twist(0.0, 0.0, -one.twist.lateral)),
            lambda time: Twist(0.0, 0.0, 0.15),
            1.5,
            "m to the left in",
            id="sign of the sideways speed",
        ),
        pytest.param(jumping(4.0), ahead, 8.5, "its pose jumps by more than 0.15 m", id="jumps"),
        pytest.param(jumping(0.5), ahead, 1.5, "its pose jumps by", id="jumps often"),
    ],
)
def test_odometry_that_contradicts_itself_is_told_with_the_pair_that_differs(
    sensor: Sensor, motion: Motion, within: float, last: str
) -> None:
    found = contradictions(sensor, motion, platform=SLIDES)
    assert found[0][0] <= within
    assert any(last in text for _, text in found[-250:])


@pytest.mark.parametrize("gap", [0.05, 1.0])
def test_far_jumps_of_the_pose_are_told_with_their_size(gap: float) -> None:
    """28.5 m each 5 s, as an estimator with two hypotheses gives them; docs/safety.md.

    `gap`: s between the two readings of a jump.
    """
    monitor, texts = FollowingMonitor(BURGER), list[str]()
    shift = shifted_at = 0.0
    time = 0.0
    while time < 16.0:
        if time - shifted_at >= 5.0:
            shift, shifted_at = 28.5 - shift, time
            time += gap - 0.05
        monitor.on_command(Twist(0.15))
        monitor.on_odometry(Odometry(time, Pose(0.15 * time + shift, 0.0, 0.0), Twist(0.15)))
        if monitor.text:
            texts.append(f"{time:.2f} {monitor.text}")
        time = round(time + 0.05, 9)
    assert 9.9 < float(texts[0].split()[0]) < 12.1  # at the second jump: one is a correction
    told = float(texts[0].partition("last by ")[2].split()[0])
    assert told == pytest.approx(28.5, abs=0.2)  # beside 0.15 m/s of its own in up to a second
    assert "contradicts itself" in texts[-1]


def test_one_far_jump_of_the_pose_is_a_correction() -> None:
    monitor = FollowingMonitor(BURGER)
    for step in range(400):
        time = 0.05 * step
        monitor.on_command(Twist(0.15))
        x = 0.15 * time + (28.5 if step > 200 else 0.0)
        monitor.on_odometry(Odometry(time, Pose(x, 0.0, 0.0), Twist(0.15)))
        assert monitor.text == ""


def disturbed(seed: int, *, slip: float, noise: float, jitter: float, lost: float) -> Sensor:
    """A sensor whose twist misses slip, with noise (m, rad; m/s, rad/s) and stamps late by jitter.

    Stamps are whole numbers of 10 ms, and some are alike.
    """
    draw = Random(seed)

    def read(one: Odometry) -> Odometry | None:
        a, b, c, d = (draw.gauss(0.0, noise) for _ in range(4))
        pose = Pose(one.pose.x + 0.1 * a, one.pose.y + 0.1 * b, one.pose.yaw + 0.1 * c)
        twist = one.twist
        measured = Twist(twist.linear / slip + d, twist.angular / slip - d, twist.lateral / slip)
        stamp = round(one.stamp + draw.uniform(0.0, jitter), 2)
        return None if draw.random() < lost else Odometry(stamp, pose, measured)

    return read


def reset_at(seconds: float) -> Sensor:
    """Odometry begins again at zero at this time."""
    kept = list[Pose]()

    def read(one: Odometry) -> Odometry:
        if one.stamp < seconds:
            return one
        kept.append(one.pose)
        dx, dy, yaw = one.pose.x - kept[0].x, one.pose.y - kept[0].y, kept[0].yaw
        turned = dx * math.cos(yaw) + dy * math.sin(yaw), dy * math.cos(yaw) - dx * math.sin(yaw)
        return Odometry(one.stamp, Pose(*turned, one.pose.yaw - yaw), one.twist)

    return read


def slides(time: float) -> Twist:
    return Twist(0.1 * math.sin(time), 0.4, 0.15 * math.cos(0.7 * time))


@pytest.mark.parametrize("motion", [ahead, circle, to_and_fro, restless, waves, slides])
@pytest.mark.parametrize(
    "sensor",
    [
        disturbed(1, slip=1.0, noise=0.0, jitter=0.0, lost=0.0),
        disturbed(2, slip=0.98, noise=0.05, jitter=0.0, lost=0.0),
        disturbed(3, slip=0.9, noise=0.02, jitter=0.05, lost=0.0),
        disturbed(4, slip=1.1, noise=0.02, jitter=0.03, lost=0.3),
        reset_at(4.0),
    ],
    ids=["exact", "slip 2 %, noise", "slip 10 %, uneven stamps", "lost readings", "reset"],
)
def test_odometry_with_slip_noise_lost_readings_or_a_reset_does_not_contradict_itself(
    sensor: Sensor, motion: Motion
) -> None:
    assert contradictions(sensor, motion, platform=SLIDES) == []


def test_a_base_that_is_pushed_by_hand_does_not_contradict_itself() -> None:
    found = rides(lambda time: ZERO, lambda time, twist: Twist(0.4, 1.0, 0.2), platform=SLIDES)
    assert found
    assert not any("contradicts" in text for _, text in found)


def test_a_contradiction_ends_by_itself() -> None:
    def heals(one: Odometry) -> Odometry:
        return one if one.stamp > 5.0 else Odometry(one.stamp, one.pose, ZERO)

    found = contradictions(heals, ahead)
    assert found[0][0] < 2.0
    assert 5.0 < found[-1][0] < 12.0


@compares_forms
def test_compiled_and_interpreted_code_say_the_same() -> None:
    draw, ones = Random(2), [kernel.FollowingMonitor(BURGER) for kernel in both_forms(KERNEL)]
    stamp, pose, texts = 0.0, Pose(), list[list[str]]()
    for _ in range(4000):
        stamp += draw.choice((0.05, 0.05, 0.05, 0.0, 0.2, 0.4))
        twist = Twist(draw.choice((0.2, 0.2, 0.2, 0.0)), draw.choice((0.0, 0.0, 1.0)))
        pose = Pose(pose.x + draw.choice((0.0, 0.0, 0.01, 2.0)), pose.y, pose.yaw + 0.01)
        for one in ones:
            if len(texts) % 20 == 0:
                one.on_command(twist)
            one.on_odometry(Odometry(stamp, pose, Twist()))
        texts.append([one.text for one in ones])
        bearings = [one.blocked_bearing for one in ones]
        assert bearings[0] == bearings[1] or all(map(math.isnan, bearings))
    assert all(one == other for one, other in texts)
    assert {bool(one) for one, _ in texts} == {True, False}
