"""Cooperative transport: pushes where the lamp is hidden, and goes around the box where not."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from swarmd.core.values import Detection, Inputs, Outputs, Twist
from swarmd.patterns.cooperative_transport.pattern import CooperativeTransport
from swarmd.settings.platforms import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import scan_of

BURGER = load_platform("burger")
PLATFORM = replace(BURGER, provides=BURGER.provides | CooperativeTransport.needs)
FREE = scan_of(PLATFORM)


class TestCooperativeTransport(PatternContract):
    pattern = CooperativeTransport


def seen(*objects: Detection) -> Outputs:
    """The first step of a robot that recognises these."""
    pattern: Any = Subject(CooperativeTransport, PLATFORM, {}).make()
    outputs: Outputs = pattern.step(Inputs(now=0.0, dt=0.0, scan=FREE, detections=objects))
    return outputs


def twist_of(outputs: Outputs) -> Twist:
    assert outputs.twist is not None
    return outputs.twist


def test_without_a_box_it_searches() -> None:
    assert seen(Detection("lamp", 0.0, 2.0)).report == {"state": "search"}
    assert seen().report == {"state": "search"}


def test_it_pushes_straight_where_the_lamp_is_hidden() -> None:
    found = seen(Detection("box", 0.0, 0.3))
    assert found.report == {"state": "push"}
    assert twist_of(found).linear == pytest.approx(0.1)
    assert twist_of(found).angular == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_goes_around_by_the_shorter_way_where_the_lamp_is_seen(side: float) -> None:
    # The lamp is beside the box ahead; behind the box, seen from there, is the other side.
    lamp = Detection("lamp", side * math.atan2(1.0, 0.6), math.hypot(1.0, 0.6))
    found = seen(Detection("box", 0.0, 0.6), lamp)
    assert found.report == {"state": "around"}
    assert twist_of(found).angular * side < 0.0


def test_it_does_not_close_on_a_robot_on_its_way() -> None:
    found = seen(Detection("box", 0.0, 0.6), Detection("robot", 0.0, 0.25, "other"))
    assert twist_of(found).linear <= 0.0


def test_another_box_farther_away_changes_nothing() -> None:
    near = Detection("box", 0.4, 0.5, "a")
    assert seen(Detection("box", -1.0, 2.0, "b"), near) == seen(near)


def test_it_declares_what_it_touches() -> None:
    zone = CooperativeTransport.touches
    assert (zone.bearing, zone.speed) == (0.0, 0.1)
