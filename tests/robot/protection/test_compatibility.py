"""Which robots see each other, and whose speed is more than another one assumes."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from msgspec import structs

from swarmd.core.messages import PeerFinding
from swarmd.core.values import Limits
from swarmd.robot.protection.compatibility import (
    ACCEPTS_NONE,
    Accepts,
    assumed_speed,
    body_of,
    fastest_corner,
    findings,
    sees,
)
from swarmd.settings.platforms import load_platform
from tests.support.platforms import with_mode

NAMES = ("burger", "jackal", "thymio", "waffle_pi")
BLIND = {("jackal", "burger"), ("jackal", "waffle_pi"), ("jackal", "thymio"),
         ("burger", "waffle_pi"), ("burger", "thymio"),
         ("waffle_pi", "thymio"), ("thymio", "jackal")}  # fmt: skip


def found(own: str, peer: str, accepts: Accepts = ACCEPTS_NONE) -> list[PeerFinding]:
    platform = load_platform(own)
    body, speed = body_of(platform), assumed_speed(platform)
    return list(findings(body, speed, "other", body_of(load_platform(peer)), accepts))


def test_a_scan_plane_above_or_below_a_robot_misses_it() -> None:
    bodies = {name: body_of(load_platform(name)) for name in NAMES}
    missed = {(a, b) for a in NAMES for b in NAMES if not sees(bodies[a], bodies[b])}
    assert missed == BLIND


def test_a_plane_at_the_very_top_or_bottom_meets_the_robot() -> None:
    burger = body_of(load_platform("burger"))
    low, high = (structs.replace(burger, scan_plane=h) for h in (burger.lowest, burger.highest))
    assert sees(low, burger)
    assert sees(high, burger)
    assert not sees(structs.replace(burger, scan_plane=0.203), burger)
    assert not sees(structs.replace(burger, scan_plane=0.009), burger)


def test_an_unseen_or_faster_peer_holds_the_robot_and_says_why() -> None:
    (unseen,) = found("jackal", "burger")
    assert (unseen.kind, unseen.holds) == ("unseen", True)
    assert "0.284" in unseen.text
    assert "0.202" in unseen.text
    (faster,) = found("burger", "jackal")
    assert (faster.kind, faster.holds) == ("faster", True)
    assert "0.60" in faster.text
    assert "0.30" in faster.text
    assert [finding.kind for finding in found("burger", "waffle_pi")] == ["unseen", "faster"]
    assert found("waffle_pi", "burger") == []
    assert found("burger", "burger") == []


def test_what_the_configuration_accepts_holds_nobody_and_shows_the_reason() -> None:
    accepts = Accepts.of({"burger": "a fence keeps them apart"}, [])
    (unseen,) = found("jackal", "burger", accepts)
    assert not unseen.holds
    assert "a fence keeps them apart" in unseen.text
    (other,) = found("jackal", "waffle_pi", accepts)
    assert other.holds
    both = found("burger", "waffle_pi", Accepts.of([], ["waffle_pi"]))
    assert [(one.kind, one.holds) for one in both] == [("unseen", True), ("faster", False)]


def test_a_peer_that_does_not_tell_its_body_or_heights_is_unknown_and_holds_nobody() -> None:
    own = body_of(load_platform("jackal"))
    (silent,) = findings(own, 0.6, "old", None, ACCEPTS_NONE)
    assert (silent.kind, silent.holds) == ("unknown", False)
    flat = body_of(replace(load_platform("burger"), heights=None))
    assert (flat.scan_plane, flat.lowest, flat.highest) == (None, None, None)
    for a, b in ((own, flat), (flat, own)):
        (unknown,) = findings(a, 0.6, "r", b, ACCEPTS_NONE)
        assert (unknown.kind, unknown.holds) == ("unknown", False)
        assert "burger" in unknown.text


@pytest.mark.parametrize("name", ["burger", "jackal"])
def test_the_speed_that_is_told_is_that_of_the_barrier_or_of_the_fastest_corner(name: str) -> None:
    platform = load_platform(name)
    barrier = platform.protection["barrier"]
    assert body_of(platform).surface_speed == barrier["others_speed"]
    slow = replace(platform, protection={**platform.protection,
                                         "barrier": {**barrier, "surface_speed": 0.2}})  # fmt: skip
    assert body_of(slow).surface_speed == 0.2
    free = with_mode(platform, "stop_zone")
    assert body_of(free).surface_speed == fastest_corner(platform) > barrier["others_speed"]
    assert assumed_speed(free) is None


def test_a_platform_without_settings_of_the_barrier_tells_its_fastest_corner() -> None:
    platform = load_platform("thymio")
    assert body_of(platform).surface_speed == fastest_corner(platform)


def test_the_fastest_corner_turns_and_drives_at_once() -> None:
    burger = replace(load_platform("burger"), limits=Limits(0.2, 2.0, 0.1))
    corner = (-0.102, -0.089)  # the farthest from the axle
    assert fastest_corner(burger) == pytest.approx(
        math.hypot(0.2 + 2.0 * abs(corner[1]), 0.1 + 2.0 * abs(corner[0]))
    )
    assert body_of(burger).radius == pytest.approx(math.hypot(*corner))
