"""The blind-zone memory of a Jackal, whose lidar reports nothing within 0.8 m."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.values import Array, Pose, Scan
from swarmd.robot.protection.footprint import ScanGeometry
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import reordered, scan_from
from tests.support.kernel_forms import both_forms, compares_forms, interpreted

pytestmark = compares_forms

FORMS = both_forms("swarmd.robot.protection.blind_zone")
JACKAL = load_platform("jackal")
GEOMETRY = ScanGeometry(JACKAL.scan)
PERIOD = 0.1
SPEED = 1.1
WIDE = range(-4, 5)
HERE = Pose()


class Memory:
    """The memory compiled and interpreted, which hold the same."""

    def __init__(self) -> None:
        self._paths = [
            kernel.HiddenObstacles(JACKAL.scan.range_min, SPEED, PERIOD) for kernel in FORMS
        ]

    def update(
        self,
        scan: Scan,
        geometry: ScanGeometry,
        moved: Pose = HERE,
        driven: Pose = HERE,
        seconds: float = PERIOD,
    ) -> None:
        for memory in self._paths:
            memory.update(scan, geometry, moved, driven, seconds)
        one, other = self._paths
        assert one.bearings == pytest.approx(other.bearings, rel=0.0, abs=1e-12)
        assert one.nearest == pytest.approx(other.nearest, rel=0.0, abs=1e-12)

    @property
    def bearings(self) -> Array:
        found: Array = self._paths[0].bearings
        return found

    @property
    def nearest(self) -> Array:
        found: Array = self._paths[0].nearest
        return found


def look(
    memory: Memory,
    near: Sequence[int] = (),
    *,
    distance: float = 0.85,
    empty: Sequence[int] = (),
    turned: float = 0.0,
    ahead: float = 0.0,
    pushed: float = 0.0,
    seconds: float = PERIOD,
    beyond: float = 3.0,
    geometry: ScanGeometry = GEOMETRY,
) -> list[int]:
    """Take in one more scan; returns the bearings of hidden obstacles in whole degrees.

    Rays `near` have returns at `distance`, rays `empty` none, all others at `beyond`. The base has
    turned by `turned` degrees since the last scan, driven `ahead` m and been pushed by `pushed` m.
    """
    ranges = np.full(360, beyond)
    ranges[list(empty)] = math.inf
    ranges[list(near)] = distance
    scan = scan_from(JACKAL, ranges, JACKAL.scan.bearings)
    yaw = math.radians(turned)
    memory.update(scan, geometry, Pose(ahead + pushed, 0.0, yaw), Pose(ahead, 0.0, yaw), seconds)
    return sorted(round(degrees) for degrees in np.degrees(memory.bearings).tolist())


def hiding() -> Memory:
    """A memory after a near obstacle ahead has vanished."""
    memory = Memory()
    look(memory, WIDE)
    look(memory, empty=WIDE)
    return memory


def test_near_obstacle_that_vanishes_is_hidden() -> None:
    memory = Memory()
    assert look(memory, WIDE) == []
    assert look(memory, empty=WIDE) == list(WIDE)


def test_order_of_the_rays_does_not_matter() -> None:
    memory = Memory()
    for distance in (0.85, math.inf):
        ranges = np.full(360, 3.0)
        ranges[20:29] = distance
        scan = reordered(scan_from(JACKAL, ranges, JACKAL.scan.bearings), np.random.default_rng(1))
        memory.update(scan, GEOMETRY)
    assert sorted(round(degrees) for degrees in np.degrees(memory.bearings)) == [*range(20, 29)]


def test_return_too_close_to_measure_is_hidden_once_it_vanishes() -> None:
    memory = hiding()
    look(memory, WIDE, distance=-math.inf)
    look(memory, WIDE, distance=-math.inf)
    assert look(memory, empty=WIDE) == list(WIDE)


def test_hidden_obstacle_approaches_at_the_assumed_speed() -> None:
    memory = hiding()
    step = SPEED * PERIOD
    assert memory.nearest == pytest.approx(JACKAL.scan.range_min - step, abs=0.05)
    for _ in range(3):
        before = memory.nearest
        look(memory, empty=WIDE)
        assert memory.nearest == pytest.approx(before - step)
    for _ in range(20):
        look(memory, empty=WIDE)
    assert (memory.nearest == 0.0).all()


def face(memory: Memory, distance: float, first: int = -90, last: int = 90) -> list[int]:
    """Take in a scan of a face ahead, from `first` to `last` degrees."""
    degrees = np.arange(first, last + 1)
    ranges = np.full(360, math.inf)
    ranges[degrees] = distance / np.maximum(np.cos(np.radians(degrees)), 1e-6)
    ranges[ranges < JACKAL.scan.range_min] = math.inf
    ranges[ranges > JACKAL.scan.range_max] = math.inf
    scan = scan_from(JACKAL, ranges, JACKAL.scan.bearings)
    memory.update(scan, GEOMETRY)
    return sorted(round(math.degrees(bearing)) for bearing in memory.bearings)


@pytest.mark.parametrize("speed", [0.02, 0.1, 0.6])
def test_wide_face_continues_between_its_visible_ends(speed: float) -> None:
    """No point of the face vanishes without a visible one beside it."""
    memory = Memory()
    for distance in np.arange(1.0, 0.35, -speed * PERIOD):
        half = math.degrees(math.acos(min(distance / JACKAL.scan.range_min, 1.0)))
        inside = face(memory, float(distance))
        if half > 6.0:
            assert inside == list(range(-math.floor(half), math.floor(half) + 1))
            assert (memory.nearest < distance).all()
        if 6.0 < half < 35.0:
            corner = distance - JACKAL.scan.range_min * math.sin(math.radians(half + 1.0))
            assert (memory.nearest > corner - 0.02).all()
    for _ in range(5):
        assert face(memory, float(distance)) == inside
    assert look(memory) == []


def test_face_in_which_a_robot_begins_continues_between_its_visible_ends() -> None:
    memory = Memory()
    assert {*range(-50, 51)} <= {*face(memory, 0.5)}


def test_end_of_a_face_is_hidden_as_far_as_it_was_seen() -> None:
    memory = Memory()
    for distance in np.arange(1.0, 0.45, -0.03):
        inside = face(memory, float(distance), 0, 90)
    assert set(range(5, 55)) <= set(inside)
    assert min(inside) >= -10
    for _ in range(50):
        face(memory, float(distance), 0, 90)
    assert set(range(5, 55)) <= set(face(memory, float(distance), 0, 90))


@pytest.mark.parametrize("distance", [1.1, 2.0])
def test_far_obstacle_that_vanishes_is_not_hidden(distance: float) -> None:
    memory = Memory()
    look(memory, WIDE, distance=distance)
    assert look(memory, empty=WIDE) == []


@pytest.mark.parametrize(("distance", "is_hidden"), [(0.85, True), (1.1, False)])
@pytest.mark.parametrize("bearing", [45, 135, 225, 315])
def test_the_blind_zone_is_around_the_lidar_not_the_axle(
    bearing: int, distance: float, is_hidden: bool
) -> None:
    geometry = ScanGeometry(replace(JACKAL.scan, offset=(0.3, 0.2)))
    memory = Memory()
    rays = range(bearing - 4, bearing + 5)
    look(memory, rays, distance=distance, geometry=geometry)
    hidden = look(memory, empty=rays, geometry=geometry)
    assert [degrees % 360 for degrees in hidden] == (list(rays) if is_hidden else [])


def test_pause_of_the_scans_hides_nothing_beyond_five_periods() -> None:
    memory = Memory()
    look(memory, WIDE, distance=1.6, seconds=2.0, beyond=math.inf)
    assert look(memory, seconds=2.0, beyond=math.inf) == []


def test_nothing_is_hidden_without_an_earlier_obstacle() -> None:
    memory = Memory()
    look(memory, WIDE)
    assert look(memory, WIDE, empty=range(100, 140)) == []


def test_return_behind_it_clears_a_hidden_obstacle() -> None:
    memory = hiding()
    assert look(memory, empty=range(0, 5)) == list(range(0, 5))
    assert look(memory) == []


def test_obstacle_that_reappears_beside_its_place_is_not_hidden() -> None:
    """In the open, rays are empty before the obstacle comes and after it has left."""
    memory = Memory()
    look(memory, WIDE, beyond=math.inf)
    assert look(memory, beyond=math.inf) == list(WIDE)
    assert look(memory, range(5, 14), beyond=math.inf) == []


@pytest.mark.parametrize(("beside", "forgets"), [(range(55, 64), True), (range(0), False)])
def test_a_doubtful_obstacle_in_the_open_expires(beside: range, forgets: bool) -> None:
    """In 0.5 s it can have moved aside by 69 degrees; what comes into view there may be it."""
    memory, far = Memory(), math.inf
    look(memory, WIDE, beyond=far)
    look(memory, beyond=far)
    for distance in (1.0, 2.4):
        seen = look(memory, beside, distance=distance, beyond=far, seconds=0.5)
        assert set(WIDE) <= set(seen)
    for _ in range(25):
        left = look(memory, beyond=far)
    assert bool(set(WIDE) & set(left)) != forgets


@pytest.mark.parametrize(
    ("face", "crosses"),
    [
        ([0.81 + 0.02 * k for k in range(12)], True),
        ([0.81, 0.83, math.inf, *[0.83 + 0.02 * k for k in range(12)]], False),
        ([0.81, 0.83, 2.0, *[0.83 + 0.02 * k for k in range(12)]], False),
        ([*[0.81] * 8, 0.835, *[3.0] * 8], True),
        ([*[0.81] * 9, 0.835, *[3.0] * 8], False),
    ],
    ids=["face", "two rays", "two rays and a step", "over eight rays", "over nine rays"],
)
def test_a_face_is_what_three_to_eight_rays_show(face: list[float], crosses: bool) -> None:
    """The face is followed from the sector to a step; the rim is at 0.8 m."""
    kernel = interpreted("swarmd.robot.protection.blind_zone", because="a function of C is asked")
    ranges = np.array([*face, *[3.0] * 20])
    assert kernel._crosses_rim(ranges, len(ranges), 0.8, 0, 1, False) == crosses


def test_noise_at_the_rim_is_no_reappearance() -> None:
    """A face in contact, whose corner is measured now and then."""
    memory = Memory()
    look(memory, WIDE, beyond=math.inf)
    look(memory, beyond=math.inf)
    for _ in range(20):
        assert set(look(memory, [4], distance=0.81, beyond=math.inf)) >= set(range(-4, 4))
        assert set(look(memory, beyond=math.inf)) >= set(range(-4, 5))


def test_thin_obstacle_reappears_as_wide_as_it_vanished() -> None:
    memory = Memory()
    look(memory, [1], beyond=math.inf)
    assert look(memory, beyond=math.inf) == [1]
    assert look(memory, [3], beyond=math.inf) == []


def test_standing_neighbor_does_not_count_as_reappearance() -> None:
    """The legs on both sides of the empty sector were visible before."""
    memory = Memory()
    near, legs = range(-1, 3), [*range(-24, -13), *range(15, 26)]
    look(memory, [*near, *legs])
    for _ in range(5):
        assert look(memory, legs, empty=near) == list(near)


def test_neighbors_in_view_do_not_explain_an_obstacle_that_vanishes() -> None:
    """The middle one of three side by side, 13 cm wide, with gaps of 1.5 cm."""
    memory = Memory()
    beside = [*range(-16, -5), *range(6, 17)]
    look(memory, [*WIDE, *beside])
    for _ in range(5):
        assert look(memory, beside, empty=WIDE) == list(WIDE)


def test_obstacle_that_moves_aside_before_a_window_is_not_hidden() -> None:
    """6 cm in each scan; nothing behind the window gives a return."""
    memory, window = Memory(), range(13)
    for left in range(0, 24, 4):
        assert look(memory, range(left, left + 13), distance=0.92, empty=window) == []


def test_obstacle_that_vanishes_before_a_wall_is_hidden() -> None:
    memory = Memory()
    look(memory, WIDE, distance=0.85, beyond=1.05)
    for _ in range(20):
        assert look(memory, empty=WIDE, beyond=1.05) == list(WIDE)


def test_slow_turns_move_hidden_obstacles() -> None:
    """A turn per scan of less than the angle between two rays."""
    memory = Memory()
    look(memory, WIDE, beyond=math.inf)
    look(memory, beyond=math.inf)
    for _ in range(120):
        found = look(memory, turned=0.3, beyond=math.inf)
    assert np.mean(found) == pytest.approx(-36.0, abs=2.0)


def test_shadow_narrower_than_a_robot_expires() -> None:
    """The edge of an obstacle that has turned away leaves such a sector."""
    memory, shadow = Memory(), range(4)
    look(memory, shadow)
    seconds = 0.0
    while look(memory, empty=shadow):
        seconds += PERIOD
        assert seconds < 10.0
    assert seconds == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("beyond", [3.0, math.inf])
@pytest.mark.parametrize("width", [6, 9])
def test_hidden_obstacle_does_not_expire(width: int, beyond: float) -> None:
    """The lidar of a Jackal is 8.5 cm wide: 6 degrees at the rim."""
    memory, shadow = Memory(), range(width)
    look(memory, shadow, beyond=beyond)
    for _ in range(100):
        assert set(shadow) <= set(look(memory, empty=shadow, seconds=0.5, beyond=beyond))


def test_robot_that_leaves_forgets_hidden_obstacles() -> None:
    memory, wide = hiding(), range(-4, 5)
    look(memory, empty=wide, beyond=math.inf)
    for ahead in (0.5, -0.5, 0.5, 0.5, 0.5):
        assert set(wide) <= set(look(memory, empty=wide, beyond=math.inf, ahead=ahead))
    assert look(memory, empty=wide, beyond=math.inf, ahead=0.2) == []


def test_robot_that_is_pushed_does_not_forget_hidden_obstacles() -> None:
    """What pushes a robot moves with it."""
    memory, wide = hiding(), range(-4, 5)
    for pushed in (0.5, -0.5, -1.5, -1.0):
        assert set(wide) <= set(look(memory, empty=wide, beyond=math.inf, pushed=pushed))


def test_hidden_obstacle_moves_with_its_empty_sector() -> None:
    memory = hiding()
    assert set(look(memory, empty=range(2, 11))) <= set(range(2, 11))
    for first in range(4, 20, 2):
        hidden = look(memory, empty=range(first, first + 9))
        assert hidden
        assert set(hidden) <= set(range(first, first + 9))


def test_hidden_obstacle_keeps_its_place_when_the_robot_turns() -> None:
    memory = hiding()
    assert look(memory, empty=range(-44, -35), turned=40.0) == list(range(-44, -35))


def test_single_lost_ray_hides_nothing() -> None:
    memory = Memory()
    look(memory, WIDE)
    assert look(memory, range(-4, 4), empty=range(4, 5)) == []
