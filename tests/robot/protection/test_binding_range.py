"""The binding range and the narrowest passages, by hand for a base with round numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swarmd.core.clock import TICK
from swarmd.core.values import Limits, Platform
from swarmd.robot.protection.binding_range import BindingRange
from swarmd.robot.protection.modes import make_mode, narrowest_passage
from swarmd.robot.protection.settings import BarrierSettings
from swarmd.settings.platforms import load_platform
from tests.support.kernel_forms import interpreted

CORNER = 0.1 * math.sqrt(2.0)
SETTINGS = BarrierSettings(
    others_speed=0.4, unseen_extent=0.1, margin=0.03, braking_linear=1.0, braking_angular=3.0
)


def a_base(linear: float = 0.2) -> Platform:
    """A square of 20 cm with the lidar in its middle, which turns at 2 rad/s at most."""
    burger = load_platform("burger")
    corners = [[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]]
    scan = replace(burger.scan, offset=(0.0, 0.0), rate=5.0, latency=0.05, sweep=None)
    return replace(burger, footprint=np.array(corners), limits=Limits(linear, 2.0), scan=scan)


def test_a_fresh_scan_binds_where_the_base_and_the_other_meet_while_it_brakes() -> None:
    """0.667 s to brake a turn of 2 rad/s: 0.4 * (0.05 + 0.333) + 0.4 * (0.05 + 0.667) + 0.13."""
    assert BindingRange(a_base(), SETTINGS, TICK).fresh == pytest.approx(0.57)


def test_a_base_that_is_faster_than_others_binds_farther_away() -> None:
    """0.8 s to brake 0.8 m/s: 0.8 * (0.05 + 0.4) + 0.4 * (0.05 + 0.8) + 0.13."""
    assert BindingRange(a_base(0.8), SETTINGS, TICK).fresh == pytest.approx(0.83)


def test_both_approach_while_a_scan_grows_old() -> None:
    """By 0.4 m/s and 0.4 m/s for half a second."""
    binding = BindingRange(a_base(), SETTINGS, TICK)
    assert binding.for_age(0.5) == pytest.approx(0.57 + 0.4)
    assert binding.for_scan_age(0.5) == pytest.approx(0.57 + 0.4)


def test_a_circle_that_stays_free_needs_room_for_two_that_stop() -> None:
    """0.3 + 2 * 0.4 * (0.1 + 0.5 + 0.2) + 0.4 * 0.5; a small circle binds less than the outline."""
    for radius, gap in ((0.3, 1.14), (0.02, 0.97)):
        settings = BarrierSettings(
            others_speed=0.4, unseen_extent=0.1, keep_out=radius, braking_linear=1.0
        )
        assert BindingRange(a_base(), settings, TICK).for_scan_age(0.5) == pytest.approx(gap)


@pytest.mark.parametrize(("linear", "keep_out"), [(0.2, None), (0.2, 0.3), (0.8, 0.3), (0.8, 0.02)])
def test_the_kernel_binds_at_the_same_gap(linear: float, keep_out: float | None) -> None:
    module = interpreted("swarmd.robot.protection.barrier_assumptions", because="calls C's methods")
    settings = BarrierSettings(
        others_speed=0.4, unseen_extent=0.1, keep_out=keep_out, braking_linear=0.5
    )
    binding = BindingRange(a_base(linear), settings, TICK)
    kernel = module.Assumptions(a_base(linear), settings)
    for age in (0.0, 0.2, 0.7):
        assert kernel.binding_range(age) == pytest.approx(binding.for_scan_age(age))


def test_the_sensor_must_see_as_far_for_the_oldest_ray_of_the_oldest_scan() -> None:
    """A scan acts for 3.5 turns + 0.05 + 0.05 s; a ray is half a turn of 0.2 s older at most."""
    binding = BindingRange(a_base(), SETTINGS, TICK)
    assert binding.stale == pytest.approx(0.8)
    assert binding.for_sensor() == pytest.approx(CORNER + 0.57 + 0.8 * 0.9)


def test_the_envelope_binds_as_far_as_others_come_in_the_age_of_a_scan() -> None:
    assert BindingRange(a_base(), SETTINGS, TICK).for_envelope() == pytest.approx(0.57 + 0.4 * 0.8)


@pytest.mark.parametrize(
    ("keep_out", "door", "corridor", "meeting"),
    [
        # post: 0.13 + 0.4 * 0.15 + 0.03; wall: 0.13 + 2 * 0.25 * (0.08 * sin 60 + 0.12) + 0.03;
        # creeping past a post: 0.13 + 2 * 0.25 * 0.015 + 0.03
        (None, 0.2 + 2 * 0.1675, 0.2 + 2 * 0.25464, 0.4 + 2 * 0.25464 + 0.22),
        # a base with a circle does not creep; a small circle changes nothing else
        (0.15, 0.2 + 2 * 0.22, 0.2 + 2 * 0.25464, 0.4 + 3 * 0.25464),
        # a circle of 0.5 m is wider than the base by 0.4 m on each side, and 0.03 m
        (0.5, 0.2 + 2 * 0.43, 0.2 + 2 * 0.43, 0.4 + 3 * 0.43),
    ],
)
def test_the_narrowest_door_corridor_and_meeting(
    keep_out: float | None, door: float, corridor: float, meeting: float
) -> None:
    base = a_base()
    barrier = {"others_speed": 0.4, "unseen_extent": 0.1, "keep_out": keep_out}
    given = {name: value for name, value in barrier.items() if value is not None}
    platform = replace(
        base,
        scan=replace(base.scan, near="reported"),
        protection={**base.protection, "mode": "barrier", "barrier": given},
    )
    found = narrowest_passage(make_mode(platform))
    assert found is not None
    assert (found.door, found.corridor, found.meeting) == pytest.approx(
        (door, corridor, meeting), abs=1e-4
    )


def test_the_room_ahead_counts_from_the_lidar_that_a_circle_surrounds() -> None:
    """A circle of 0.5 m is farther ahead than the outline: 0.2 m with a lidar 0.2 m ahead."""

    def ahead(lidar_x: float) -> float:
        base = a_base()
        scan = replace(base.scan, offset=(lidar_x, 0.0), near="reported")
        barrier = {"others_speed": 0.4, "unseen_extent": 0.1, "keep_out": 0.5}
        protection = {**base.protection, "mode": "barrier", "barrier": barrier}
        mode: Any = make_mode(replace(base, scan=scan, protection=protection))
        return float(mode.clearance(0.1).ahead)

    assert ahead(0.1) - ahead(-0.1) == pytest.approx(0.2)
    assert ahead(0.1) > 0.6  # the circle begins there
