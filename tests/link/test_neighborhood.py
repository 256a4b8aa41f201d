"""Neighbors by range and by link, with hysteresis, in pure time."""

from __future__ import annotations

import pytest

from swarmd.core.neighbor_places import NeighborPlaces, TimedPose
from swarmd.core.values import Detection, Neighbor, PeerPlace, Pose, SharedPose
from swarmd.link.members.neighbor_settings import NeighborSettings
from swarmd.link.members.neighborhood import Link, Neighborhood, PlaceNeighbors


def as_heard(neighbors: tuple[Neighbor, ...], now: float) -> tuple[Neighbor, ...]:
    return neighbors


def by_range(meters: float = 1.0, place: PlaceNeighbors = as_heard) -> Neighborhood:
    return Neighborhood(NeighborSettings(neighborhood="range", range=meters), place)


def near(neighborhood: Neighborhood, *candidates: Neighbor, now: float = 0.0) -> list[str]:
    return [one.id for one in neighborhood.select(candidates, now) if one.in_reach]


def at(meters: float | None) -> Neighbor:
    return Neighbor("r02", 0.0, meters)


def place(x: float, *, age: float = 0.0, frame: str = "map") -> PeerPlace:
    return PeerPlace("r02", frame, x, 0.0, 0.05, age)


def own_pose(*, frame: str = "map") -> SharedPose:
    return SharedPose(0.0, Pose(0.0, 0.0, 0.0), 0.05, 0.02, frame)


def test_all_robots_are_neighbors_by_default() -> None:
    assert near(
        Neighborhood(NeighborSettings(), as_heard), at(None), Neighbor("r03", 0.0, 99.0)
    ) == [
        "r02",
        "r03",
    ]


def test_a_robot_within_the_range_stays_a_neighbor_a_little_beyond_it() -> None:
    robot = by_range(1.0)
    steps = [(1.05, []), (1.0, ["r02"]), (1.09, ["r02"]), (1.11, []), (1.05, [])]
    for meters, expected in steps:
        assert near(robot, at(meters)) == expected, meters


def test_those_out_of_reach_stay_for_protection() -> None:
    (one,) = by_range(1.0).select([Neighbor("r02", 0.0, 3.0, 0.5)], 0.0)
    assert (one.in_reach, one.distance, one.bearing) == (False, 3.0, 0.5)


def test_a_robot_of_unknown_distance_is_out_of_reach() -> None:
    assert near(by_range(), at(None)) == []


class Robot:
    """What a robot knows of places: the own pose, and those of others."""

    def __init__(self) -> None:
        self.own: TimedPose | None = None
        self.known = NeighborPlaces()

    def place(self, neighbors: tuple[Neighbor, ...], now: float) -> tuple[Neighbor, ...]:
        return self.known.by_poses(neighbors, self.own, now)


def test_told_places_give_the_distance_while_they_are_fresh() -> None:
    robot = Robot()
    range = by_range(1.0, robot.place)
    robot.known.on_place(place(0.8, age=0.3), 10.0)
    assert near(range, at(None), now=10.0) == []  # without an own pose
    robot.own = TimedPose(own_pose(), 10.0)
    robot.known.on_place(place(0.8, age=0.2), 10.0)
    assert near(range, at(None), now=10.8) == ["r02"]
    assert near(range, at(None), now=10.81) == []
    robot.known.on_place(place(0.8, frame="other"), 11.0)
    assert near(range, at(None), now=11.0) == []


def test_a_measured_distance_precedes_a_told_one() -> None:
    robot = Robot()
    robot.own = TimedPose(own_pose(), 10.0)
    robot.known.on_place(place(0.5), 10.0)
    assert near(by_range(1.0, robot.place), at(2.0), now=10.0) == []


def test_the_place_of_a_tag_gives_no_reach() -> None:
    """It says where a robot is that is seen, and is no part of the settings of neighborhoods."""
    robot = Robot()
    robot.known.on_detections((Detection("robot", 0.0, 0.5, "r02"),), 10.0)
    assert near(by_range(1.0, robot.place), at(None), now=10.0) == []


@pytest.mark.parametrize(
    ("link", "before", "after"),
    [
        (Link(0.8), False, True),
        (Link(0.79), False, False),
        (Link(0.61), True, True),
        (Link(0.59), True, False),
        (Link(1.0, -80.0), False, False),
        (Link(1.0, -75.0), False, True),
        (Link(1.0, -80.9), True, True),
        (Link(1.0, -81.1), True, False),
        (None, True, False),
    ],
)
def test_links_have_a_hysteresis(link: Link | None, before: bool, after: bool) -> None:
    settings = NeighborSettings(neighborhood="link", quality=0.8, signal=-75.0)
    robot = Neighborhood(settings, as_heard)
    if before:
        assert robot.select([at(None)], 0.0, {"r02": Link(1.0, -50.0)})[0].in_reach
    links = {} if link is None else {"r02": link}
    assert robot.select([at(None)], 0.0, links)[0].in_reach is after


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        (NeighborSettings(neighborhood="range"), "range"),
        (NeighborSettings(range=1.0), "range"),
        (NeighborSettings(signal=-70.0), "signal"),
    ],
)
def test_settings_that_contradict_each_other_are_named(
    settings: NeighborSettings, key: str
) -> None:
    assert [where for where, _ in settings.faults()] == [key]
