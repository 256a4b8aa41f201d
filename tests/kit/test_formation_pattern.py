"""Formations: sensing, driving to a place and resting there, tested with a line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.values import Inputs, Neighbor, Odometry, Platform, Pose, Scan, Twist, Value
from swarmd.kit.behavior import Pattern
from swarmd.kit.factory import assemble
from swarmd.kit.formation_pattern import FormationParams
from swarmd.patterns.line_formation.pattern import LineFormation
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import Subject
from swarmd.testing.scans import Disc, scan_of
from tests.kit.test_formation_geometry import seen

BURGER = load_platform("burger")  # kin gives it the places of some peers
HEARING = frozenset({"neighbors", "neighbors.distance", "neighbors.bearing"})
SENSING = replace(BURGER, provides=(BURGER.provides - {"kin"}) | HEARING)
DEAF = replace(BURGER, provides=frozenset({"scan", "odometry"}))
EMPTY = scan_of(BURGER)


def make(platform: Platform = SENSING, **params: Value) -> Pattern[FormationParams]:
    return Subject(LineFormation, platform, params).make()


def step(
    pattern: Pattern[FormationParams],
    neighbors: Sequence[Neighbor] = (),
    *,
    scan: Scan = EMPTY,
    now: float = 0.0,
    pose: Pose | None = None,
) -> tuple[Twist, str]:
    """The requested command and the state."""
    odometry = Odometry(now, pose or Pose(), Twist())
    outputs = pattern.step(
        Inputs(now, 0.1, scan, is_new_scan=True, odometry=odometry, neighbors=tuple(neighbors))
    )
    assert outputs.twist is not None
    return outputs.twist, str(outputs.report["state"])


def test_it_turns_and_drives_to_its_place() -> None:
    twist, state = step(make(), seen((-1.0, 0.0), (2.0, 0.0)))
    assert state == "form"
    assert twist.linear > 0.1
    twist, _ = step(make(), seen((-1.1, 0.5), (1.1, 0.5)))
    assert twist.angular > 0.1
    twist, _ = step(make(), seen((-1.1, -0.5), (1.1, -0.5)))
    assert twist.angular < -0.1


def test_the_nearer_its_place_the_slower() -> None:
    far, near = (step(make(), seen((-1.1, 0.0), (1.1 + x, 0.0)))[0] for x in (1.2, 0.4))
    assert far.linear > near.linear > 0.0


def test_it_rests_while_its_place_is_within_the_tolerance() -> None:
    pattern = make(tolerance=0.1)
    assert step(pattern, seen((-1.1, 0.0), (1.1, 0.0))) == (Twist(), "settled")
    # The middle between its neighbours is 0.09 m off.
    for now in range(1, 60):
        found = step(pattern, seen((-1.1, 0.0), (1.28, 0.0)), now=float(now))
    assert found == (Twist(), "settled")
    for now in range(60, 120):
        twist, state = step(pattern, seen((-1.1, 0.0), (1.55, 0.0)), now=float(now))
    assert state == "form"
    assert twist.linear > 0.0


def test_alone_it_does_not_move() -> None:
    assert step(make()) == (Twist(), "alone")
    assert step(make(), [Neighbor("r1", 0.0)]) == (Twist(), "alone")
    assert step(make(), [Neighbor("r1", 0.0, math.nan, 0.0)]) == (Twist(), "alone")
    assert step(make(range=2.0), seen((3.0, 0.0))) == (Twist(), "alone")
    assert step(make(BURGER)) == (Twist(), "alone")


def test_a_robot_that_is_no_longer_sensed_is_dropped() -> None:
    pattern = make()
    step(pattern, seen((-1.1, 0.0), (1.1, 0.0), (2.2, 3.0)))
    for now in range(1, 40):
        found = step(pattern, seen((-1.1, 0.0), (1.1, 0.0)), now=float(now))
    assert found[1] == "settled"


def test_it_keeps_clear_of_obstacles_in_its_way() -> None:
    free, _ = step(make(), seen((-1.1, 0.0), (2.9, 0.0)))
    blocked, _ = step(make(), seen((-1.1, 0.0), (2.9, 0.0)), scan=scan_of(BURGER, [Disc(0.7, 0.0)]))
    assert free.linear > 0.2
    assert blocked.linear < 0.05


def test_needs_follow_from_sensing() -> None:
    assert make().needs == LineFormation.needs | {"neighbors.distance", "neighbors.bearing"}
    for platform in (BURGER, DEAF):
        assert make(platform).needs == LineFormation.needs
    assert make(BURGER, sensing="neighbors").needs >= {"neighbors.distance"}
    assert make(sensing="lidar").needs == LineFormation.needs
    with pytest.raises(PluginError, match=r"neighbors\.bearing, neighbors\.distance"):
        assemble(
            "line_formation",
            (("test", {"sensing": "neighbors"}),),
            find=lambda name: LineFormation,
            robot="r0",
            platform=DEAF,
            rng=np.random.default_rng(0),
        )


def test_sensing_cannot_change_to_missing_hardware() -> None:
    pattern = make(DEAF)
    good = pattern.params
    with pytest.raises(ConfigError, match=r"neighbors\.bearing"):
        pattern.update(msgspec.structs.replace(good, sensing="neighbors"))
    assert pattern.params is good


@pytest.mark.parametrize(
    ("params", "subject"),
    [
        ({"spacing": 0.5}, "spacing"),
        ({"spacing": 0.5, "clearance": 0.3}, "the protection of burger"),
        ({"spacing": 0.7, "clearance": 0.8}, "the clearance"),
    ],
)
def test_a_spacing_that_is_too_small_is_refused(params: dict[str, Value], subject: str) -> None:
    with pytest.raises(ConfigError, match=subject):
        Subject(LineFormation, SENSING, params).make()
