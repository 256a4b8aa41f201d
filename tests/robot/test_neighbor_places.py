"""Distance, bearing and heading of neighbours by shared poses and by detections."""

from __future__ import annotations

import math

import pytest
from msgspec import structs

from swarmd.core import neighbor_places
from swarmd.core.events import DetectionsInput
from swarmd.core.neighbor_places import NeighborPlaces, TimedPose
from swarmd.core.values import Detection, Neighbor, PeerPlace, Pose, SharedPose, Value, lacks_text
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names, places_of
from swarmd.robot.own_pose import FASTEST_POSE
from swarmd.robot.protection.compatibility import body_of
from swarmd.robot.sensors import Sensors
from swarmd.settings.platforms import load_platform
from swarmd.settings.settings import with_options

# The patterns that need places of neighbours and no further sensor of the floor.
BY_NEIGHBORS = (
    "chain_formation", "hexagonal_lattice", "leader_following", "lloyd_coverage", "shepherding",
    "vicsek_alignment",
)  # fmt: skip
HEARD = Neighbor("b", 0.2)
OWN = SharedPose(0.0, Pose(1.0, 2.0, math.pi / 2), error=0.02, yaw_error=0.01, frame="map")
AT_10 = TimedPose(OWN, 10.0)


def place(x: float, y: float, heading: float | None = None, **changes: object) -> PeerPlace:
    given = {"robot": "b", "frame": "map", "error": 0.03, "age": 0.1, **changes}
    return PeerPlace(x=x, y=y, heading=heading, **given)  # type: ignore[arg-type]


def completed(
    *places: PeerPlace, heard: Neighbor = HEARD, own: SharedPose | None = OWN, after: float = 0.0
) -> Neighbor:
    """The neighbour `after` s, after the own pose and the places at 10 s."""
    known = NeighborPlaces()
    for one in places:
        known.on_place(one, 10.0)
    timed = None if own is None else TimedPose(own, 10.0)
    (neighbor,) = known.complete((heard,), timed, 10.0 + after)
    return neighbor


# The own robot is at (1, 2) and faces +y.
@pytest.mark.parametrize(
    ("at", "distance", "bearing", "heading"),
    [
        (place(1.0, 5.0, math.pi / 2), 3.0, 0.0, 0.0),  # ahead, the same heading
        (place(-1.0, 2.0, -math.pi), 2.0, math.pi / 2, math.pi / 2),  # to the left, facing -x
        (place(4.0, -2.0, 0.0), 5.0, -math.pi / 2 - math.atan2(4.0, 3.0), -math.pi / 2),  # behind
        (place(2.0, 3.0), math.sqrt(2.0), -math.pi / 4, None),  # from an older version
    ],
)
def test_a_peer_has_its_place_in_the_base_frame(
    at: PeerPlace, distance: float, bearing: float, heading: float | None
) -> None:
    peer = completed(at)
    assert peer.id == "b"
    assert peer.distance == pytest.approx(distance)
    assert peer.bearing == pytest.approx(bearing)
    assert peer.heading == (None if heading is None else pytest.approx(heading))


def test_the_error_is_that_of_both_places_and_of_the_yaw_over_the_distance() -> None:
    assert completed(place(1.0, 5.0)).error == pytest.approx(0.02 + 0.03 + 0.01 * 3.0)


def test_the_age_is_that_of_the_older_pose() -> None:
    assert completed(place(1.0, 5.0, age=0.3), after=0.5).age == pytest.approx(0.8)
    assert completed(place(1.0, 5.0, age=0.0), after=0.5).age == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("places", "own", "after"),
    [
        ([place(1.0, 5.0, age=0.6)], OWN, 0.41),  # the place is 1.01 s old
        ([place(1.0, 5.0, age=-1.0)], OWN, 1.01),  # the own pose is
        ([place(1.0, 5.0, frame="other")], OWN, 0.0),
        ([place(1.0, 5.0, robot="c")], OWN, 0.0),
        ([place(1.0, 5.0)], None, 0.0),
        ([], OWN, 0.0),
    ],
)
def test_an_old_place_and_one_of_another_frame_are_left_out(
    places: list[PeerPlace], own: SharedPose | None, after: float
) -> None:
    assert completed(*places, own=own, after=after) == HEARD


def test_a_place_counts_for_one_second() -> None:
    assert completed(place(1.0, 5.0, age=0.6), after=0.39).distance == pytest.approx(3.0)


def test_a_measured_field_precedes_the_place() -> None:
    measured = Neighbor("b", 0.2, 2.5, 0.5, 0.25)
    assert completed(place(1.0, 5.0, 1.0), heard=measured) == measured
    ranged = completed(place(1.0, 5.0, math.pi / 2), heard=Neighbor("b", 0.2, 2.5))
    assert (ranged.distance, ranged.age) == (2.5, 0.2)
    assert [ranged.bearing, ranged.heading] == pytest.approx([0.0, 0.0])


def seen(*detections: Detection, after: float = 0.1, at: PeerPlace | None = None) -> Neighbor:
    known = NeighborPlaces()
    known.on_detections(detections, 10.0)
    if at is not None:
        known.on_place(at, 10.0)
    known.on_detections(None, 10.05)  # no fresh value: the last place grows old
    (neighbor,) = known.complete((HEARD,), AT_10, 10.0 + after)
    return neighbor


def test_a_detected_peer_has_distance_and_bearing_without_a_frame() -> None:
    peer = seen(Detection("robot", 0.4, 1.5, "b"), Detection("robot", 1.0, 0.5, "c"))
    assert (peer.distance, peer.bearing, peer.heading) == (1.5, 0.4, None)
    assert peer.age == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("detection", "after"),
    [
        (Detection("robot", 0.4, 1.5, "b"), 1.01),
        (Detection("robot", 0.4, None, "b"), 0.1),  # a bearing alone
        (Detection("box", 0.4, 1.5, "b"), 0.1),
    ],
)
def test_other_and_old_detections_give_no_place(detection: Detection, after: float) -> None:
    assert seen(detection, after=after) == HEARD


def test_a_detection_precedes_the_place_which_adds_the_heading() -> None:
    peer = seen(Detection("robot", 0.4, 1.5, "b"), at=place(1.0, 5.0, math.pi))
    assert (peer.distance, peer.bearing) == (1.5, 0.4)
    assert peer.heading == pytest.approx(math.pi / 2)


def test_the_places_of_more_peers_than_the_bound_drop_the_oldest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(neighbor_places, "MAX_PEERS", 2)
    known = NeighborPlaces()
    for robot in ("b", "c", "b", "d"):
        known.on_place(place(1.0, 5.0, robot=robot), 10.0)
    peers = known.complete((HEARD, Neighbor("c", 0.0), Neighbor("d", 0.0)), AT_10, 10.0)
    assert [peer.distance is None for peer in peers] == [False, True, False]


def posed_robot() -> Sensors:
    """A Burger whose driver gives a shared pose, after 1 s of poses at 10 Hz up to 10 s."""
    robot = Sensors(with_options(load_platform("burger"), {"shared_pose": "pose"}))
    for tick in range(91, 101):
        robot.on_pose(structs.replace(OWN, stamp=0.1 * tick), 0.1 * tick)
    return robot


def test_a_robot_with_a_pose_hands_the_places_of_its_neighbors_to_its_pattern() -> None:
    robot = posed_robot()
    robot.on_neighbors((HEARD, Neighbor("c", 0.0)), 10.0)
    robot.on_place(place(1.0, 5.0, math.pi / 2), 10.0)
    peer, other = robot.inputs(10.0, 0.1).neighbors
    assert [peer.distance, peer.bearing] == pytest.approx([3.0, 0.0])
    assert peer.age == pytest.approx(0.1)  # of the place: the own pose is FASTEST_POSE / 2 old
    assert other == Neighbor("c", 0.0)
    assert robot.inputs(11.0 - 0.5 * FASTEST_POSE + 0.01, 0.1).neighbors[0].distance is None


def test_protection_does_not_take_a_computed_place_for_a_measured_one() -> None:
    robot = posed_robot()
    robot.on_neighbors((HEARD,), 10.0)
    robot.on_place(place(1.0, 5.0), 10.0)
    robot.inputs(10.0, 0.1)
    robot.on_neighbors((HEARD,), 10.1)
    assert robot.peers.told(10.1) == ()


def test_a_robot_with_a_table_of_tags_hands_the_place_of_a_seen_peer_to_its_pattern() -> None:
    options: dict[str, Value] = {"detections": {"front": {"robots": {"7": "b"}, "size": 0.2}}}
    robot = Sensors(with_options(load_platform("burger"), options))
    robot.on_neighbors((HEARD,), 10.0)
    robot.on_option_input(DetectionsInput((Detection("robot", 0.4, 1.5, "b"),)), 10.0)
    (peer,) = robot.inputs(10.2, 0.1).neighbors
    assert (peer.distance, peer.bearing, peer.heading) == (1.5, 0.4, None)


def test_a_robot_without_a_pose_has_neighbors_as_heard() -> None:
    robot = Sensors(load_platform("burger"))
    robot.on_neighbors((HEARD,), 10.0)
    robot.on_place(place(1.0, 5.0), 10.0)
    assert robot.inputs(10.0, 0.1).neighbors == (HEARD,)


@pytest.mark.parametrize(
    ("needs", "words"),
    [
        ({"neighbors.bearing", "scan"}, ["neighbors.bearing", "thymio", "shared_pose", "hardware"]),
        ({"gripper"}, ["gripper", "thymio"]),
        ({"scan"}, []),
    ],
)
def test_a_refusal_names_what_is_lacking_and_both_ways_to_places(
    needs: set[str], words: list[str]
) -> None:
    text = lacks_text(frozenset(needs), load_platform("thymio"))
    assert [word for word in words if word in text] == words
    assert bool(text) is bool(words)
    assert ("shared_pose" in text) is ("shared_pose" in words)
    assert "\n" not in text


def test_the_patterns_of_neighbors_are_made_by_kin_or_a_pose_and_refused_without() -> None:
    posed = with_options(load_platform("thymio"), {"shared_pose": "pose"})
    find = PatternLoader(places_of(pattern_names(None)))
    for name in BY_NEIGHBORS:
        assert not lacks_text(find(name).needs, posed), name
        assert not lacks_text(find(name).needs, load_platform("burger")), name
        assert "shared_pose" in lacks_text(find(name).needs, load_platform("thymio")), name
    assert "reading:ground" in lacks_text(find("shelter_choice").needs, posed)


@pytest.mark.parametrize(
    ("told", "radius"),
    [
        (None, math.hypot(0.06 + 0.06 * 2.0, math.radians(6.0) * 2.0)),
        (0.4, 0.4),
        (0.0, 0.0),  # told: the source says that the place is exact
    ],
)
def test_protection_takes_the_told_error_of_a_place_if_it_has_one(
    told: float | None, radius: float
) -> None:
    burger = body_of(load_platform("burger"))
    jackal = Sensors(load_platform("jackal"))  # its lidar misses a Burger
    jackal.on_peers({"b": burger})
    jackal.on_neighbors((Neighbor("b", 0.0, 2.0, 0.0, error=told),), 10.0)
    (disc,) = jackal.peers.told(10.0)
    assert disc.radius == pytest.approx(burger.radius + radius)


def test_the_nearest_of_two_tags_of_one_robot_counts_and_a_measured_distance_precedes_it() -> None:
    known = NeighborPlaces()
    near, far = Detection("robot", 0.2, 0.5, "b"), Detection("robot", 3.0, 9.0, "b")
    for both in ((near, far), (far, near)):
        known.on_detections(both, 10.0)
        (peer,) = known.complete((HEARD,), None, 10.1)
        assert (peer.distance, peer.bearing) == (0.5, 0.2)
    (peer,) = known.complete((Neighbor("b", 0.2, 1.0),), None, 10.1)
    assert (peer.distance, peer.bearing) == (1.0, 0.2)


def test_an_older_place_that_comes_late_replaces_no_newer_one() -> None:
    known = NeighborPlaces()
    own = TimedPose(SharedPose(10.0, Pose(), 0.1, 0.05, place(1.0, 0.0).frame), 10.0)
    known.on_place(place(1.0, 0.0, age=0.05), 10.0)
    known.on_place(place(2.0, 0.0, age=0.9), 10.0)
    (peer,) = known.complete((HEARD,), own, 10.0)
    assert peer.distance == pytest.approx(1.0)


@pytest.mark.parametrize("error", [-5.0, math.nan, math.inf])
def test_an_error_that_is_none_makes_a_neighbor_invalid(error: float) -> None:
    assert not Neighbor("b", 0.0, 2.0, 0.0, error=error).is_valid
    assert Neighbor("b", 0.0, 2.0, 0.0, error=0.3).is_valid
