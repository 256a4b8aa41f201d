"""A robot that is set down beside something leaves it, and the table says what it did.

The wanted metres are those of docs/evidence/beside.md: 0.1 m in 40 s for a platform that may creep,
and no touch faster than 1.5 cm/s.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from studies import keeper
from studies.safety import beside
from studies.safety.beside import (
    HEADINGS,
    THINGS,
    Cell,
    Found,
    Record,
    by_gap,
    cells,
    keep,
    load,
    named_gap,
    place_of,
    scenario_for,
    simulate,
    summary,
)
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.sim.world.geometry import gaps, transform

FOUND = Found(
    near=0.0, far=0.004, path=0.01, left=None, seconds=120.0, least_gap=0.05, touches=0, faults=0,
    hardest=0.0, held=0.998, reason="protection",
)  # fmt: skip
LEFT = replace(
    FOUND, near=0.21, far=0.5, left=95.0, seconds=96.0, held=0.1, touches=1, hardest=0.008
)

EVIDENCE = Path(__file__).parents[3] / "docs" / "evidence"
WANTED = 0.1  # m
WITHIN = 40.0  # s
CREEP = 0.015  # m/s
LEAVE = [
    ("turtlebot4", "wall", 0.05, 0.0),
    ("turtlebot4", "wall", 0.3, 0.0),
    ("turtlebot4", "wall", 0.1, 45.0),
    ("turtlebot4", "wall", 0.2, 180.0),
    ("turtlebot4", "pole", 0.3, 0.0),
    ("turtlebot4", "corridor", 0.3, 0.0),
    ("waffle_pi", "wall", 0.05, 0.0),
    ("waffle_pi", "wall", 0.3, 0.0),
    ("waffle_pi", "wall", 0.12, 45.0),
    ("waffle_pi", "box", 0.2, 0.0),
    ("burger", "wall", 0.05, 0.0),
    ("burger", "wall", 0.16, 0.0),
    ("burger", "wall", 0.08, 45.0),
    ("burger", "robot", 0.05, 90.0),
    ("rosbot_xl", "wall", 0.2, 0.0),
    ("rosbot_xl", "corner", 0.2, 180.0),
    # These do not creep: from the distance that their page names they drive off.
    ("jackal", "wall", 0.74, 0.0),
    ("epuck2", "wall", 0.05, 0.0),
    ("thymio", "wall", 0.05, 0.0),
]


@pytest.mark.parametrize(("platform", "thing", "gap", "heading"), LEAVE)
def test_a_robot_that_nothing_touches_leaves(
    platform: str, thing: str, gap: float, heading: float
) -> None:
    cell = Cell(platform, thing, gap, heading)
    found = simulate(cell, away=WANTED, at_least=0.0, at_most=WITHIN).found
    assert found.near >= WANTED
    assert (found.faults, found.hardest <= CREEP) == (0, True)


def test_a_robot_that_may_not_creep_keeps_its_circle_free() -> None:
    """The Jackal, 0.3 m from a wall: its page says that 0.92 m around its lidar must be free."""
    found = simulate(Cell("jackal", "wall", 0.3, 0.0), at_most=10.0, at_least=10.0).found
    assert (found.touches, found.reason) == (0, "protection")
    assert found.far < WANTED


CREEPERS = ("burger", "waffle_pi", "turtlebot4", "rosbot_xl")


def kept() -> dict[Cell, Found]:
    """The values of the runs of docs/evidence/beside.md."""
    return load(EVIDENCE / "beside.jsonl")


def test_beside_a_wall_each_platform_leaves_from_the_distance_that_it_names() -> None:
    named = {name: named_gap(name) for name in platform_names()}
    left = {
        cell.platform: found.left
        for cell, found in kept().items()
        if cell.mode == "platform" and cell.beside == "wall" and cell.gap == named[cell.platform]
    }
    assert left.keys() >= {*CREEPERS, "jackal", "crazyflie"}
    assert None not in left.values()


def test_no_robot_that_creeps_was_at_fault_or_touched_faster_than_it_creeps() -> None:
    some = [
        found
        for cell, found in kept().items()
        if cell.mode == "platform" and cell.platform in CREEPERS
    ]
    assert len(some) >= 80
    assert sum(found.faults for found in some) == 0
    assert max(found.hardest for found in some) <= CREEP + 5e-4


def test_no_robot_that_creeps_stood_beside_a_wall_and_the_control_did() -> None:
    runs = kept()
    at_wall = [
        found
        for cell, found in runs.items()
        if cell.beside == "wall" and cell.mode == "platform" and cell.platform in CREEPERS
    ]
    resting = [
        found for cell, found in runs.items() if cell.mode == "still" and cell.platform in CREEPERS
    ]
    assert min(found.far for found in at_wall) >= WANTED
    assert max(found.far for found in resting) < 0.001


@pytest.mark.parametrize("thing", THINGS)
@pytest.mark.parametrize("heading", HEADINGS)
def test_the_outline_begins_at_the_gap_from_the_thing(thing: str, heading: float) -> None:
    cell = Cell("burger", thing, 0.2, heading)
    place = place_of(cell)
    x, y, degrees = place.pose
    pose = np.array((x, y, math.radians(degrees)))
    burger = load_platform("burger").footprint
    outline = transform(burger, pose)
    bodies = list(place.bodies)
    if place.other is not None:
        at, ahead, turned = place.other
        bodies.append(transform(burger, np.array((at, ahead, math.radians(turned)))))
    if thing in ("wall", "corner"):  # of the arena of 6 x 6 m
        assert 3.0 - outline[:, 1].max() == pytest.approx(0.2)
        assert bool(3.0 - outline[:, 0].max() == pytest.approx(0.2)) is (thing == "corner")
    else:
        nearest = min(float(gaps(outline, body)) for body in bodies)
        assert nearest == pytest.approx(0.2, abs=3e-4)


@pytest.mark.parametrize("mode", beside.MODES)
def test_each_mode_is_a_scenario_and_a_robot_that_rests_asks_for_nothing(mode: str) -> None:
    cell = Cell("turtlebot4", "robot", 0.3, 0.0, mode)
    robots = scenario_for(cell, place_of(cell)).robots
    assert len(robots) == 2


def test_controls_have_the_plain_wall_alone() -> None:
    found = cells(["burger"], THINGS, [0.05], HEADINGS, ["platform", "off", "still"])
    assert sum(cell.mode == "platform" for cell in found) == len(THINGS) * len(HEADINGS)
    assert {(cell.beside, cell.heading) for cell in found if cell.mode == "off"} == {("wall", 0.0)}


def test_values_are_kept_by_run_and_stand_before_an_arrow(tmp_path: Path) -> None:
    cell = Cell("burger", "wall", 0.05, 0.0)
    record = Record(cell, FOUND)
    keep([record], tmp_path / "before.jsonl")
    before = load(tmp_path / "before.jsonl")
    assert before == {cell: FOUND}
    row = summary({cell: LEFT}, before).splitlines()[2]
    texts = [text.strip() for text in row.strip("|").split("|")]
    assert texts == [
        *("`burger`", "1", "1 → 0", "0 → 1", "0 → 1", "100% → 10%", "0.050", "0 → 1", "0"),
        "0.0 → 0.8",
    ]
    assert "0.00, 0.00 → 0.21, ≥0.50" in by_gap({cell: LEFT}, before)


def test_cells_without_motion_get_more_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def simulated(cell: Cell) -> Found:
        return FOUND if cell.beside == "pole" else LEFT

    monkeypatch.setattr(beside, "simulate", simulated)
    monkeypatch.setattr(keeper, "code_of", lambda perform: "these sources")
    wanted = [Cell("burger", thing, 0.05, 0.0) for thing in ("wall", "pole", "box")]
    records = beside.carry_out(wanted, (1, 3, 4), 1, tmp_path / "runs.jsonl")
    counts = [sum(one.task.beside == thing for one in records) for thing in ("wall", "pole", "box")]
    assert counts == [4, 3, 1]


@pytest.mark.parametrize("platform", platform_names())
def test_each_platform_has_a_scenario_beside_a_robot_of_its_kind(platform: str) -> None:
    cell = Cell(platform, "robot", 0.2, 0.0)
    assert len(scenario_for(cell, place_of(cell)).robots) == 2
