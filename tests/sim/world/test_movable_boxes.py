"""Movable boxes: pushed, sliding, stuck, seen, placed and removed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.settings.platforms import load_platform
from swarmd.sim.world.arena import Arena, Box, Pole, Segment
from swarmd.sim.world.geometry import gaps, transform
from swarmd.sim.world.world import World
from tests.support.platforms import with_plain_scan

WAFFLE = with_plain_scan(load_platform("waffle_pi"))
FRICTION = 0.4 * 9.81


def facing(box: Box, arena: Arena | None = None, yaw: float = 0.0) -> World:
    """A Waffle Pi at the origin."""
    space = arena or Arena(20.0, 20.0, boxes=(box,))
    return World({"a": WAFFLE}, space, np.array([[0.0, 0.0, yaw]]))


def ahead(mass: float, yaw: float = 0.0) -> Box:
    """A box half a metre ahead of a robot that heads to `yaw`."""
    x, y = 0.5 * math.cos(yaw), 0.5 * math.sin(yaw)
    return Box(x, y, 0.3, 0.3, yaw, name="crate", mass=mass)


def drive(world: World, linear: float, seconds: float) -> None:
    world.set_commands(np.array([[linear, 0.0, 0.0]]))
    world.step(round(seconds / world.dt))


def sliding(velocity: tuple[float, float, float], box: Box) -> World:
    world = facing(box)
    world.data.qvel[3:] = velocity
    return world


def test_a_box_slides_when_pushed_and_comes_to_rest() -> None:
    world = facing(ahead(1.0))
    drive(world, 0.2, 5.0)
    pushed = world.box_poses()[0]
    assert pushed[0] > 1.0
    assert world.poses()[0, 0] + 0.086 == pytest.approx(pushed[0] - 0.15, abs=1e-3)
    drive(world, 0.0, 1.0)
    stopped = world.box_poses()[0]
    assert stopped[0] - pushed[0] < 0.01
    drive(world, 0.0, 60.0)
    np.testing.assert_allclose(world.box_poses()[0], stopped, atol=1e-6)


@pytest.mark.parametrize("yaw", [0.0, 0.3, math.pi / 4.0, 1.2, 2.0])
def test_the_floor_holds_the_same_mass_in_every_direction(yaw: float) -> None:
    # The tyres hold 0.8 of the robot's 1.8 kg, the floor 0.4 of the box: 3.6 kg is the limit.
    moved = []
    for mass in (3.4, 3.9):
        world = facing(ahead(mass, yaw), yaw=yaw)
        drive(world, 0.2, 8.0)
        moved.append(math.dist(world.box_poses()[0, :2], world.arena.boxes[0].corners.mean(0)))
    assert moved[0] > 0.5
    assert moved[1] < 0.01


@pytest.mark.parametrize("heading", [0.0, 0.4, math.pi / 4.0, 1.5])
def test_a_sliding_box_stops_by_coulombs_law(heading: float) -> None:
    box = Box(3.0, 0.0, 0.4, 0.2, 0.7, mass=2.0)
    world = sliding((math.cos(heading), math.sin(heading), 0.0), box)
    world.step(100)
    way = world.box_poses()[0] - [3.0, 0.0, 0.7]
    half_a_step = 0.005  # the speed of a step is that at its end
    assert math.hypot(*way[:2]) == pytest.approx(0.5 / FRICTION - half_a_step, rel=0.01)
    assert math.atan2(way[1], way[0]) == pytest.approx(heading, abs=1e-2)
    assert way[2] == pytest.approx(0.0, abs=1e-6)


def test_a_spinning_box_stops_too_and_sooner_if_it_is_larger() -> None:
    turns = []
    for size in (0.2, 0.6):
        world = sliding((0.0, 0.0, 5.0), Box(3.0, 0.0, size, size, mass=2.0))
        world.step(300)
        turns.append(float(world.box_poses()[0, 2]))
        assert np.abs(world.data.qvel[3:]).max() < 1e-9
    # For a square of side s: w^2 I / (2 mu m g lever) = 5^2 s / (2 * 3.924 * 6 * 0.3826), less
    # half a step, since the speed of a step is that at its end.
    np.testing.assert_allclose(turns, np.array([0.2, 0.6]) * 1.388 - 0.025, atol=1e-3)


def test_a_box_is_stopped_by_walls_and_pushes_other_boxes() -> None:
    boxes = tuple(Box(x, 0.0, 0.3, 0.3, mass=0.5) for x in (0.4, 1.0))
    world = facing(boxes[0], Arena(4.0, 4.0, boxes=boxes))
    touched = set()
    for _ in range(150):
        drive(world, 0.2, 0.1)
        touched |= {(contact.a, contact.b) for contact in world.contacts()}
    assert touched == {("a", "box/0")}  # what boxes do among themselves is no robot's contact
    near, far = world.box_poses()[:, 0]
    assert far == pytest.approx(1.85, abs=2e-3)
    assert near == pytest.approx(1.55, abs=3e-3)


def test_a_contact_with_a_box_has_both_speeds() -> None:
    world = sliding((-2.0, 0.0, 0.0), ahead(1.0))
    world.set_commands(np.array([[0.2, 0.0, 0.0]]))
    while not world.contacts():
        world.step()
    (contact,) = world.contacts()
    assert (contact.a, contact.b) == ("a", "box/crate")
    assert contact.speed_a > 0.1
    assert 0.1 < contact.speed_b < 2.0


def test_out_of_the_arena_it_is_neither_seen_nor_touched() -> None:
    world = facing(ahead(1.0))
    world.remove("crate")
    assert np.isnan(world.box_poses()).all()
    assert not np.isfinite(world.scans(np.array([0]))[0].ranges).any()
    met = []
    for _ in range(50):
        drive(world, 0.2, 0.1)
        met += world.contacts()
    assert met == []
    assert world.poses()[0, 0] > 0.9  # straight through where it stood


def test_comes_and_goes_and_comes_again() -> None:
    box = Box(0.0, 0.0, 0.3, 0.3, name="late", mass=1.0, is_placed=False)
    world = facing(box)
    assert world.movable_boxes == ("late",)
    assert world.box_shapes.shape == (1, 4, 2)
    assert np.isnan(world.box_poses()).all()
    world.step(10)
    for x in (1.0, 0.7):
        world.place("late", (x, 0.0, 0.0))
        np.testing.assert_array_equal(world.box_poses(), [[x, 0.0, 0.0]])
        assert world.scans(np.array([0]))[0].ranges[0] == pytest.approx(x - 0.15 + 0.064)
        world.step(100)
        np.testing.assert_allclose(world.box_poses(), [[x, 0.0, 0.0]], atol=1e-9)
    world.remove("late")
    world.step(10)
    assert not np.isfinite(world.scans(np.array([0]))[0].ranges).any()


def test_is_at_rest_where_it_is_placed_whatever_it_did_before() -> None:
    world = sliding((2.0, 0.0, 3.0), Box(3.0, 0.0, 0.3, 0.3, name="crate", mass=1.0))
    world.step(5)
    world.remove("crate")
    world.step()
    world.place("crate", (-3.0, 0.0, 0.0))
    world.step(50)
    np.testing.assert_allclose(world.box_poses(), [[-3.0, 0.0, 0.0]], atol=1e-9)


def test_a_long_box_is_refused_if_its_far_end_overlaps_a_robot() -> None:
    world = facing(Box(0.0, 3.0, 2.0, 0.2, name="beam", mass=1.0))
    with pytest.raises(SwarmError, match=r"overlap a$"):
        world.place("beam", (1.0, 0.0, 0.0))
    world.place("beam", (1.2, 0.0, 0.0))


CROWDED = Arena(
    6.0, 6.0,
    boxes=(
        Box(2.0, 0.0, 0.5, 0.5),
        Box(0.0, -2.0, 0.3, 0.3, name="crate", mass=1.0),
        Box(0.0, 2.0, 0.3, 0.3, name="other", mass=1.0),
        Box(0.0, 0.0, 0.3, 0.3, name="late", mass=1.0, is_placed=False),
    ),
    poles=(Pole(-2.0, 0.0, 0.1),),
    segments=(Segment(-2.0, -2.0, -2.0, -1.0),),
)  # fmt: skip


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        ((0.1, 0.1, 0.3), "a"),
        ((2.3, 0.1, 0.0), "box/0"),
        ((0.2, 2.0, 0.0), "box/other"),
        ((-2.0, 0.2, 0.0), "pole/0"),
        ((-2.1, -1.5, 0.0), "segment/0"),
        ((2.9, 2.0, 0.0), "outside"),
        ((9.0, 2.0, 0.0), "outside"),
        ((math.nan, 2.0, 0.0), "finite"),
    ],
)
@pytest.mark.parametrize("box", ["crate", "late"])
def test_an_overlapping_box_is_refused_and_nothing_changes(
    box: str, pose: tuple[float, float, float], reason: str
) -> None:
    world = facing(CROWDED.boxes[0], CROWDED)
    before = world.box_poses()
    with pytest.raises(SwarmError, match=rf"{box}.*{reason}\b"):
        world.place(box, pose)
    np.testing.assert_array_equal(world.box_poses(), before)
    world.step(10)
    np.testing.assert_allclose(world.box_poses(), before, atol=1e-12)


@pytest.mark.parametrize(
    ("others", "reason"),
    [
        ((Box(0.3, 2.0, 0.5, 0.5),), "box/1"),
        ((Box(0.2, 2.0, 0.3, 0.3, name="other", mass=1.0),), "box/other"),
    ],
)
def test_a_box_cannot_start_in_an_obstacle(others: tuple[Box, ...], reason: str) -> None:
    crate = Box(0.0, 2.0, 0.3, 0.3, name="crate", mass=1.0)
    with pytest.raises(ConfigError, match=rf"crate.*{reason}"):
        facing(crate, Arena(6.0, 6.0, boxes=(crate, *others)))
    with pytest.raises(ConfigError, match="outside"):
        facing(crate, Arena(6.0, 4.0, boxes=(crate,)))


def test_boxes_may_be_adjacent() -> None:
    boxes = (Box(0.0, 2.0, 0.5, 0.5, mass=1.0), Box(0.5, 2.0, 0.5, 0.5, mass=1.0))
    world = facing(boxes[0], Arena(6.0, 6.0, boxes=boxes))
    world.step(100)
    np.testing.assert_allclose(world.box_poses()[:, 0], [0.0, 0.5], atol=1e-6)


def test_a_box_that_is_gone_leaves_its_place_to_others() -> None:
    world = facing(CROWDED.boxes[0], CROWDED)
    world.place("crate", (0.1, -2.0, 0.5))  # overlaps its own old place
    world.remove("other")
    world.place("late", (0.0, 2.0, 0.0))
    with pytest.raises(SwarmError, match=r"other.*box/late"):
        world.place("other", (0.0, 2.0, 0.0))


def test_only_movable_boxes_are_placed_and_removed() -> None:
    world = facing(CROWDED.boxes[0], CROWDED)
    with pytest.raises(ConfigError, match=r"'crat'.*'crate'"):
        world.place("crat", (1.0, 1.0, 0.0))
    with pytest.raises(ConfigError, match="'0'"):
        world.remove("0")
    with pytest.raises(SwarmError, match="late"):
        world.remove("late")


def test_a_crowd_with_boxes_is_stable() -> None:
    n = 8
    turn = 2.0 * np.pi * np.arange(n) / n
    starts = np.stack((2.0 * np.cos(turn), 2.0 * np.sin(turn), turn + np.pi), axis=-1)
    masses = (0.2, 1.0, 5.0, 1e6)
    boxes = tuple(
        Box(0.9 * math.cos(a), 0.9 * math.sin(a), 0.3, 0.2, a, mass=mass)
        for a, mass in zip(np.arange(0.2, 6.0, 1.6).tolist(), masses, strict=True)
    )
    world = World({f"r{i}": WAFFLE for i in range(n)}, Arena(6.0, 6.0, boxes=boxes), starts)
    world.set_commands(np.tile((0.26, 0.0, 0.0), (n, 1)))
    fastest = 0.0
    for _ in range(100):
        world.step(10)
        fastest = max(fastest, float(np.abs(world.data.qvel[:]).max()))
    shapes = transform(world.box_shapes, world.box_poses())
    assert fastest < 3.0
    assert min(world.data.contact.dist) > -2e-3
    assert max(float(gaps(shapes[0], shapes[i])) for i in range(1, 4)) > 0.0
