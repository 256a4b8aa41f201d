"""The frames of a robot as tf2 gives them; all wanted places are computed by hand."""

from __future__ import annotations

import math

import pytest

from swarmd.ros2_nodes.transforms import (
    KEPT,
    ConnectivityException,
    ExtrapolationException,
    Frames,
    InvalidArgumentException,
    LookupException,
    Transform,
)

QUARTER = (0.0, 0.0, math.sin(math.pi / 4.0), math.cos(math.pi / 4.0))
NONE = (0.0, 0.0, 0.0, 1.0)


def frames() -> Frames:
    """`odom` is at x = 1 m in `map`, turned to the left; the base moves from x = 0 to 1 m."""
    made = Frames()
    made.set("map", "odom", 0, Transform((1.0, 0.0, 0.0), QUARTER), is_static=True)
    made.set("odom", "base", 1000, Transform(), is_static=False)
    made.set("odom", "base", 2000, Transform((1.0, 0.0, 0.0), NONE), is_static=False)
    made.set("base", "scan", 0, Transform((0.0, 0.5, 0.0), NONE), is_static=True)
    made.set("home", "door", 0, Transform(), is_static=True)
    return made


def test_a_place_goes_through_the_common_frame() -> None:
    """Ahead in `odom` is y in `map`, and left of the base is -x."""
    place, at = frames().lookup("map", "/scan", 0)
    assert at == 2000
    assert place.origin == pytest.approx((0.5, 1.0, 0.0))
    assert place.rotation == pytest.approx(QUARTER)


def test_the_inverse_undoes_a_place() -> None:
    there, _ = frames().lookup("map", "scan", 0)
    back, _ = frames().lookup("scan", "map", 0)
    assert there.then(back).origin == pytest.approx((0.0, 0.0, 0.0))
    assert back.origin == pytest.approx((-1.0, 0.5, 0.0))


def test_between_two_times_a_place_is_between() -> None:
    place, at = frames().lookup("odom", "base", 1250)
    assert at == 1250
    assert place.origin == pytest.approx((0.25, 0.0, 0.0))


@pytest.mark.parametrize("at", [999, 2001])
def test_nothing_is_extrapolated(at: int) -> None:
    with pytest.raises(ExtrapolationException):
        frames().lookup("odom", "base", at)


def test_unknown_and_unconnected_frames_are_told_apart() -> None:
    with pytest.raises(LookupException, match="tower"):
        frames().lookup("odom", "tower", 0)
    with pytest.raises(ConnectivityException):
        frames().lookup("odom", "door", 0)


def test_frames_in_a_circle_have_an_end() -> None:
    made = Frames()
    made.set("a", "b", 0, Transform(), is_static=True)
    made.set("b", "a", 0, Transform(), is_static=True)
    assert made.lookup("a", "b", 0)[0] == Transform()


def test_old_places_are_forgotten() -> None:
    made = Frames()
    for at in (0, 1, KEPT + 1):
        made.set("odom", "base", at, Transform(), is_static=False)
    with pytest.raises(ExtrapolationException):
        made.lookup("odom", "base", 1)
    made.lookup("odom", "base", KEPT + 1)


@pytest.mark.parametrize(
    ("parent", "child", "place"),
    [
        ("", "base", Transform()),
        ("base", "/base", Transform()),
        ("odom", "base", Transform((math.nan, 0.0, 0.0), NONE)),
        ("odom", "base", Transform(rotation=(0.0, 0.0, 0.0, 0.0))),
    ],
)
def test_what_is_no_place_is_refused(parent: str, child: str, place: Transform) -> None:
    with pytest.raises(InvalidArgumentException):
        frames().set(parent, child, 0, place, is_static=False)
