"""Observations: each part scaled into [-1, 1], and the declaration in a file."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Inputs, Limits, Neighbor, Odometry, Pose, Twist
from swarmd.kit.observation import (
    NeighborsPart,
    Part,
    PolicySpec,
    ReadingPart,
    RobotsPart,
    ScanPart,
    TwistPart,
    decode_spec,
    default_spec,
    encode_spec,
    observe,
    requested_twist,
)
from swarmd.settings.settings import load_platform, platform_names
from swarmd.testing.scans import Disc, busy_scans, odd_scans, scan_of

BURGER = load_platform("burger")
ALL = PolicySpec(
    (ScanPart(), RobotsPart(), NeighborsPart(), ReadingPart("light"), TwistPart(lateral=True)),
    lateral=True,
    period=0.2,
)


def observed(part: Part, inputs: Inputs) -> list[float]:
    values = observe(PolicySpec((part,)), inputs, BURGER)
    assert values.dtype == np.float32
    found: list[float] = values.tolist()
    return found


def test_scan_sectors_are_near_at_1_and_free_at_minus_1() -> None:
    inputs = Inputs(0.0, 0.0, scan_of(BURGER, [Disc(1.0, 0.0), Disc(0.0, 3.0)], room=None))
    values = observed(ScanPart(sectors=4, range=2.0), inputs)
    ahead = 1.0 - (1.0 - Disc(1.0, 0.0).radius - BURGER.scan.offset[0])
    assert values == pytest.approx([ahead, -1.0, -1.0, -1.0], abs=0.02)


def test_robots_are_apart_from_walls() -> None:
    inputs = Inputs(0.0, 0.0, scan_of(BURGER, [Disc(0.0, 1.0)], room=4.0))
    walls, robots = ScanPart(sectors=4, range=3.0), RobotsPart(sectors=4, range=3.0)
    assert all(value > -0.4 for value in observed(walls, inputs))
    found = observed(robots, inputs)
    assert found[1] > 0.3
    assert [found[0], *found[2:]] == [-1.0, -1.0, -1.0]


def test_neighbors_come_by_distance_with_their_number() -> None:
    neighbors = (
        Neighbor("a", 0.0, distance=2.0, bearing=math.pi / 2),
        Neighbor("b", 0.0, distance=1.0, bearing=0.0),
        Neighbor("c", 0.0),  # not sensed
        Neighbor("d", 0.0, distance=9.0, bearing=0.0),  # too far
    )
    values = observed(NeighborsPart(count=4, range=4.0), Inputs(0.0, 0.0, neighbors=neighbors))
    assert values == pytest.approx(
        [0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0, -1.0, 0.0, 0.0], abs=1e-6
    )


@pytest.mark.parametrize(
    ("readings", "value"), [({"heat": 30.0}, 0.5), ({"heat": 99.0}, 1.0), ({}, 0.0)]
)
def test_a_reading_is_scaled_and_limited(readings: dict[str, float], value: float) -> None:
    part = ReadingPart("heat", low=0.0, high=40.0)
    assert observed(part, Inputs(0.0, 0.0, readings=readings)) == pytest.approx([value])


def test_a_twist_is_by_the_limits_of_the_base() -> None:
    odometry = Odometry(0.0, Pose(), Twist(0.11, -9.0))
    limits = BURGER.limits
    values = observed(TwistPart(), Inputs(0.0, 0.0, odometry=odometry))
    assert values == pytest.approx([0.11 / limits.linear, -1.0])


@pytest.mark.parametrize("name", platform_names())
def test_every_observation_is_within_its_bounds_and_as_long_as_declared(name: str) -> None:
    platform = load_platform(name)
    spec = default_spec(platform)
    assert spec.needs <= platform.provides
    for scan in (None, *busy_scans(platform, 3), *odd_scans(platform).values()):
        for declared in (spec, ALL):
            values = observe(declared, Inputs(0.0, 0.0, scan), platform)
            assert values.shape == (declared.size,) == (len(declared.names),)
            assert (np.abs(values) <= 1.0).all()  # false for NaN


def test_a_declaration_is_the_same_after_its_file() -> None:
    assert decode_spec(encode_spec(ALL)) == ALL
    assert ALL.actions == 3
    assert len(set(ALL.names)) == ALL.size == 12 + 12 + 10 + 1 + 3
    assert ALL.needs == {
        "scan", "neighbors.distance", "neighbors.bearing", "reading:light", "odometry"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (b"{}", "parts"),
        (b'{"parts": []}', "parts"),
        (b'{"parts": [{"part": "camera"}]}', "camera"),
        (b'{"parts": [{"part": "scan", "sectors": 0}]}', "sectors"),
        (b'{"parts": [{"part": "scan", "colour": 1}]}', "colour"),
        (b'{"parts": [{"part": "reading", "name": "x", "low": 2}]}', "reading x"),
        (b'{"parts": [{"part": "scan"}], "period": 0.01}', "period"),
        (b"\xff", "declaration"),
    ],
)
def test_a_wrong_declaration_is_named(text: bytes, word: str) -> None:
    with pytest.raises(ConfigError, match=word):
        decode_spec(text)


@pytest.mark.parametrize(("low", "high"), [(-math.inf, 1.0), (0.0, math.inf), (1.0, 1.0)])
def test_a_reading_needs_a_finite_range(low: float, high: float) -> None:
    with pytest.raises(ValueError, match="reading x"):
        PolicySpec((ReadingPart("x", low=low, high=high),))


def test_an_action_is_a_share_of_the_limits_and_no_more() -> None:
    limits = Limits(0.2, 2.0, 0.1)
    assert requested_twist(ALL, np.array([0.5, -2.0, -1.0]), limits) == Twist(0.1, -2.0, -0.1)
    plain = PolicySpec((ScanPart(),))
    assert requested_twist(plain, np.array([-1.0, 0.25]), limits) == Twist(-0.2, 0.5)
