"""Items: drawn places, pucks that robots push, and flat items that grippers carry to a nest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.settings.platforms import load_platform
from swarmd.sim.metrics.delivery import delivered, items_delivered
from swarmd.sim.metrics.window import tall_boxes
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import TraceBuilder
from swarmd.sim.world.arena import Arena, Box, parse_arena
from swarmd.sim.world.item_kind import ItemKind, with_items
from swarmd.sim.world.world import World
from tests.support.platforms import with_plain_scan

BURGER = with_plain_scan(load_platform("burger"))
FRONT = float(BURGER.footprint[:, 0].max())
NEST = (-1.0, 0.0, 0.5)


def world_of(
    *kinds: ItemKind,
    starts: Sequence[tuple[float, float, float]] = ((0.0, 0.0, 0.0),),
    seed: int = 0,
    boxes: tuple[Box, ...] = (),
) -> World:
    arena = Arena(6.0, 4.0, boxes, items=tuple(item for kind in kinds for item in kind.things))
    robots = {f"r{i}": BURGER for i in range(len(starts))}
    return World(robots, arena, np.array(starts), items=kinds, seed=seed)


def food(**keys: Any) -> ItemKind:
    return ItemKind(name="food", **{"source": (2.0, 0.0, 0.5), "nest": NEST, **keys})


def drive(world: World, linear: float, seconds: float) -> None:
    world.set_commands(np.array([[linear, 0.0, 0.0]] * len(world.ids)))
    world.step(round(seconds / world.dt))


def test_a_count_is_drawn_in_the_source_by_the_seed_and_without_overlap() -> None:
    kind = ItemKind(name="puck", count=60, source=(1.0, 0.0, 0.6), size=0.06, mass=0.05)
    first, same, other = (world_of(kind, seed=s).loose_poses()[:, :2] for s in (1, 1, 2))
    assert np.array_equal(first, same)
    assert not np.array_equal(first, other)
    assert (np.hypot(*(first - (1.0, 0.0)).T) <= 0.6).all()
    apart = np.hypot(*(first[:, None] - first[None]).transpose(2, 0, 1))
    assert apart[np.triu_indices(60, 1)].min() >= 0.06


def test_pucks_do_not_start_in_robots_or_boxes() -> None:
    kind = ItemKind(name="puck", count=3, source=(-0.03, 0.0, 0.05), size=0.03, mass=0.05)
    with pytest.raises(ConfigError, match="puck"):
        world_of(kind)
    with pytest.raises(ConfigError, match="food"):
        world_of(food(count=1), boxes=(Box(2.0, 0.0, 1.2, 1.2),))


def test_a_robot_pushes_a_puck_and_the_floor_stops_it() -> None:
    world = world_of(ItemKind(name="puck", at=[(0.3, 0.0)], size=0.06, mass=0.05))
    drive(world, 0.2, 5.0)
    pushed = world.loose_poses()[0, 0]
    assert pushed == pytest.approx(world.poses()[0, 0] + FRONT + 0.03, abs=2e-3)
    drive(world, 0.0, 1.0)
    resting = world.loose_poses()[0]
    drive(world, 0.0, 5.0)
    assert world.loose_poses()[0] == pytest.approx(resting, abs=1e-6)
    assert world.contacts() == []  # a puck is no obstacle


def test_a_sliding_puck_stops_after_the_way_of_dry_friction() -> None:
    world = world_of(ItemKind(name="puck", at=[(1.0, 0.0)], size=0.06, mass=0.05))
    world.data.qvel[3:5] = 0.6, 0.8
    world.step(200)
    way = world.loose_poses()[0, :2] - (1.0, 0.0)
    assert math.hypot(*way) == pytest.approx(1.0 / (2.0 * 0.4 * 9.81), rel=0.05)
    assert way[1] / way[0] == pytest.approx(0.8 / 0.6, rel=1e-3)


def test_a_puck_pushes_another() -> None:
    world = world_of(ItemKind(name="puck", at=[(0.3, 0.0), (0.5, 0.0)], size=0.06, mass=0.05))
    drive(world, 0.2, 4.0)
    first, second = world.loose_poses()[:, 0]
    assert second - first == pytest.approx(0.06, abs=2e-3)


def test_scans_do_not_meet_items() -> None:
    bare = world_of().scans(np.array([0]))[0].ranges
    puck = ItemKind(name="puck", at=[(0.5, 0.0)], size=0.2, mass=0.05)
    seen = world_of(puck, food(at=[(0.0, 0.5)])).scans(np.array([0]))[0].ranges
    assert np.array_equal(bare, seen)


def test_robots_read_how_many_are_near_and_where_the_nearest_is() -> None:
    kind = food(at=[(0.3, 0.4), (0.0, -0.55), (2.0, 0.0)], range=0.6)
    found = world_of(kind, starts=((0.0, 0.0, math.pi / 2.0),)).readings(0)
    assert found["food"] == 2.0
    assert found["food_distance"] == pytest.approx(0.5)
    assert found["food_bearing"] == pytest.approx(math.atan2(0.4, 0.3) - math.pi / 2.0)
    assert (found["held"], found["delivered"]) == (0.0, 0.0)
    assert set(found) <= {w.removeprefix("reading:") for w in with_items(BURGER, [kind]).provides}


def test_without_an_item_in_range_the_readings_are_zero() -> None:
    found = world_of(food(at=[(2.0, 0.0)])).readings(0)
    assert (found["food"], found["food_distance"], found["food_bearing"]) == (0.0, 0.0, 0.0)


def test_a_closing_gripper_takes_the_item_at_the_front_and_carries_it() -> None:
    world = world_of(food(at=[(FRONT + 0.05, 0.0), (FRONT + 0.06, 0.0)]))
    world.grips[0] = True
    world.step()
    assert world.readings(0)["held"] == 1.0
    assert world.readings(0)["food"] == 1.0  # the other one
    drive(world, 0.2, 2.0)
    place = world.loose_poses()[0, :2]
    assert place == pytest.approx([world.poses()[0, 0] + FRONT, 0.0], abs=1e-9)


def test_a_gripper_that_closed_on_nothing_takes_nothing_until_it_opens() -> None:
    world = world_of(food(at=[(0.5, 0.0)]))
    world.grips[0] = True
    drive(world, 0.2, 3.0)
    assert world.readings(0)["held"] == 0.0


def test_two_grippers_do_not_take_one_item() -> None:
    world = world_of(food(at=[(0.0, 0.0)]), starts=((-FRONT, 0.0, 0.0), (FRONT, 0.0, math.pi)))
    world.grips[:] = True
    world.step()
    assert [world.readings(row)["held"] for row in (0, 1)] == [1.0, 0.0]


def test_an_item_that_is_dropped_in_the_nest_is_delivered_and_another_appears() -> None:
    world = world_of(food(at=[(-1.0, 0.0)]), starts=((-1.0 - FRONT, 0.0, 0.0),))
    world.grips[0] = True
    world.step()
    world.grips[0] = False
    world.step()
    assert (world.readings(0)["held"], world.readings(0)["delivered"]) == (0.0, 1.0)
    assert math.dist(world.loose_poses()[0, :2], (2.0, 0.0)) <= 0.5


def test_an_item_that_is_dropped_elsewhere_stays_there() -> None:
    world = world_of(food(at=[(FRONT, 0.0)]))
    for is_closed in (True, False):
        world.grips[0] = is_closed
        world.step()
    drive(world, -0.2, 1.0)
    assert world.loose_poses()[0, :2] == pytest.approx([FRONT, 0.0])
    assert world.readings(0)["delivered"] == 0.0


def test_a_robot_that_is_taken_out_leaves_its_item() -> None:
    world = world_of(food(at=[(FRONT, 0.0)]), starts=((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    world.grips[0] = True
    world.step()
    world.take_out(0)
    world.step()
    assert world.loose_poses()[0, :2] == pytest.approx([FRONT, 0.0])


def test_pucks_cannot_be_gripped() -> None:
    puck = ItemKind(name="puck", at=[(FRONT + 0.04, 0.0)], size=0.06, mass=0.05)
    world = world_of(puck, food(at=[(2.0, 0.0)]))
    world.grips[0] = True
    world.step()
    assert world.readings(0)["held"] == 0.0


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("{}", "count"),
        ('{"count": 2}', "source"),
        ('{"count": 2, "at": [[0, 0]], "source": [0, 0, 1]}', "count"),
        ('{"at": [[0, 0]], "nest": [0, 0, 1]}', "source"),
        ('{"at": [[0, 0]], "source": [0, 0, 1], "nest": [0, 0, 1], "mass": 1}', "mass"),
    ],
)
def test_a_kind_without_sense_is_refused(text: str, wanted: str) -> None:
    with pytest.raises(msgspec.ValidationError, match=wanted):
        msgspec.json.decode(f'{{"name": "food", {text[1:]}'.replace(", }", "}"), type=ItemKind)


def test_the_text_of_an_arena_has_its_items() -> None:
    puck = ItemKind(name="puck", count=2, source=(0.0, 0.0, 1.0), mass=0.05)
    arena = Arena(6.0, 4.0, items=(*food(at=[(1.0, 0.25)]).things, *puck.things))
    assert parse_arena(arena.text) == arena


def test_traces_hold_items_behind_the_boxes_and_metrics_of_gaps_leave_them_out() -> None:
    crate = Box(0.0, 1.0, 0.3, 0.3, name="crate", mass=1.0)
    world = world_of(food(at=[(1.0, 0.0)]), boxes=(crate,))
    builder = TraceBuilder(
        world.ids,
        world.platforms,
        {"arena": world.arena.text},
        movable_boxes=world.loose,
        box_shapes=world.loose_shapes,
    )
    builder.add(0.0, world.poses(), np.zeros((1, 3)), world.loose_poses())
    trace = builder.trace()
    assert trace.movable_boxes == ("crate", "food-1")
    tall = tall_boxes(trace)
    assert tall is not None
    assert tall[1].shape == (1, 1, 3)


def test_delivered_items_count_for_each_robot_and_minute() -> None:
    world = world_of(starts=((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    builder = TraceBuilder(world.ids, world.platforms, {})
    for t in (0.0, 60.0, 120.0):
        builder.add(t, world.poses(), np.zeros((2, 3)))
    counts = np.array([[np.nan, 0.0], [1.0, 2.0], [np.nan, 5.0]])
    trace = replace(builder.trace(), readings={"delivered": counts})
    found = delivered(trace)
    assert found is not None
    assert found.tolist() == [0.0, 3.0, 6.0]
    assert items_delivered(trace) == 1.5
    assert items_delivered(builder.trace()) is None


@pytest.mark.parametrize("names", [("held",), ("food", "food"), ("food", "food_distance")])
def test_a_name_that_gives_a_reading_twice_is_refused(names: tuple[str, ...]) -> None:
    items = [{"name": name, "at": [[0.0, 0.0]]} for name in names]
    data = {"groups": {"all": {"count": 1, "pattern": "drive"}}, "items": items}
    with pytest.raises(ConfigError, match=rf"items\[{len(names) - 1}\].name .*'{names[-1]}'"):
        scenario_of(data)
