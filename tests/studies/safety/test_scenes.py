"""Each scene is a scenario that can run, and its robots behave as its name states."""

from __future__ import annotations

import numpy as np
import pytest

from studies.safety.runs import attackers
from studies.safety.scenes import (
    ATTACKERS,
    FAMILIES,
    MODES,
    SPARSE,
    VISIBILITIES,
    Scene,
    attack_speed,
    scenario,
)
from swarmd.core.errors import ConfigError
from swarmd.core.values import Array
from swarmd.settings.platforms import load_platform
from swarmd.sim.lockstep.lockstep import Lockstep, simulate_run
from swarmd.sim.metrics.contacts import count_of
from swarmd.sim.trace import Trace

pytestmark = pytest.mark.long

ATTACKING = ("ram", "lead", "behind", "corner", "flank", "spin")


def run(scene: Scene, seed: int = 1) -> Trace:
    return simulate_run(scenario(scene), seed)


@pytest.mark.parametrize(
    ("family", "platform"),
    [
        pytest.param(name, platform, marks=[pytest.mark.evidence] * (platform != largest))
        for name, family in FAMILIES.items()
        for *_, largest in [family.platforms]
        for platform in family.platforms
    ],
)
def test_every_scene_can_start(family: str, platform: str) -> None:
    scene = Scene(family, platform, FAMILIES[family].visibilities[0])
    made = scenario(scene)
    assert made.visibility == scene.visibility
    assert len(made.robots) == scene.room.robots
    made.starts(1000)


@pytest.mark.parametrize("platform", SPARSE)
def test_sparse_scenes_have_more_room(platform: str) -> None:
    scenes = Scene("goals", platform, is_sparse=True), Scene("goals", platform)
    areas = [scene.room.side**2 / scene.room.robots for scene in scenes]
    assert areas[0] > 2.0 * areas[1]
    scenario(scenes[0]).starts(0)


@pytest.mark.parametrize("mode", MODES)
def test_robots_have_the_protection_mode_of_the_scene(mode: str) -> None:
    scene = Scene("goals", "burger", mode=mode)
    protection = next(iter(scenario(scene).robots.values())).protection
    words = {"ghost": "off"} | dict.fromkeys(("orca", "walls_stand", "walls_foot"), "barrier")
    assert protection["mode"] == words.get(mode, mode)
    avoids = mode in ("orca", "walls_stand", "walls_foot")
    assert protection["avoidance"] == ("orca" if avoids else "none")


def test_a_third_attacks_and_is_not_protected() -> None:
    scene = Scene("ram", "mixed")
    modes = [str(one.protection["mode"]) for one in scenario(scene).robots.values()]
    assert (modes.count("off"), modes.count("barrier")) == (3, 6)
    assert scene.protected == 6


def test_a_mixed_swarm_agrees_on_one_speed_and_keeps_out_of_every_blind_zone() -> None:
    platforms = scenario(Scene("goals", "mixed")).robots.values()
    agreed = {
        (barrier["others_speed"], barrier["surface_speed"] or barrier["others_speed"],
         barrier["keep_out"])
        for barrier in (platform.protection["barrier"] for platform in platforms)
    }  # fmt: skip
    assert agreed == {(0.4, 0.4, 0.92)}


@pytest.mark.parametrize("platform", ["burger", "waffle_pi", "jackal"])
def test_unseen_extent_is_zero_with_visibility_body(platform: str) -> None:
    own = load_platform(platform).protection["barrier"]["unseen_extent"]
    unseen = [
        next(iter(scenario(Scene("goals", platform, visibility)).robots.values())).protection[
            "barrier"
        ]["unseen_extent"]
        for visibility in VISIBILITIES
    ]
    assert unseen == [0.0, own]


def test_an_unknown_scene_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(ConfigError, match="goals"):
        scenario(Scene("goal", "burger"))
    with pytest.raises(ConfigError, match="burger"):
        scenario(Scene("poles", "burgr"))


def test_robots_of_a_mixed_swarm_tell_where_they_are_if_lidars_look_over_them() -> None:
    whole, real = (scenario(Scene("ram", "mixed", visibility)) for visibility in VISIBILITIES)
    assert (whole.radio.range_and_bearing, real.radio.range_and_bearing) == (False, True)
    assert any("told by range and bearing" in note for note in real.notes)


def test_jackals_with_a_blind_zone_are_told_of_attackers_unless_the_family_tests_that() -> None:
    told = {
        family: scenario(Scene(family, "jackal", "real")).radio.range_and_bearing
        for family in ("behind", "behind_untold", "goals")
    }
    assert told == {"behind": True, "behind_untold": False, "goals": False}


def test_a_family_changes_the_realism_of_its_scenes() -> None:
    late, weak = (
        scenario(Scene(family, "burger")).realism for family in ("late_200", "weak_brakes")
    )
    assert (late.lidar.delay, late.lidar.rolling) == (0.2, True)
    assert weak.actuation.linear_acceleration == 0.7


@pytest.mark.evidence
def test_ghosts_reach_goals_and_never_touch_a_wall() -> None:
    trace = run(Scene("goals", "burger", mode="ghost", duration=40.0))
    assert (trace.report["goals"][-1] >= 1).all()
    assert count_of(trace, "arena") == 0


@pytest.mark.parametrize(
    ("seconds", "swaps"), [(22.0, 1), pytest.param(45.0, 2, marks=pytest.mark.evidence)]
)
def test_ghosts_swap_places_and_swap_back(seconds: float, swaps: int) -> None:
    trace = run(Scene("swap", "burger", mode="ghost", duration=seconds))
    assert (trace.report["goals"][-1] >= swaps).all()
    place = trace.pose[..., :2]
    across = np.hypot(*np.moveaxis(place + place[0], -1, 0))
    assert (across.min(axis=0) < 0.25).all()


def test_rushing_robots_gather_at_the_centre_and_count_no_goals() -> None:
    trace = run(Scene("rush", "burger", mode="ghost", duration=13.0))
    assert np.hypot(*trace.pose[-1, :, :2].T).max() < 0.4
    assert "goals" not in trace.report


def test_random_twists_drive_and_turn_in_both_directions() -> None:
    trace = run(Scene("twists", "burger", mode="ghost", duration=10.0))
    linear, angular = trace.safe[..., 0], trace.safe[..., 1]
    limits = load_platform("burger").limits
    assert (linear.min(), linear.max()) == pytest.approx((-limits.linear, limits.linear), rel=0.2)
    assert (angular.min(), angular.max()) == pytest.approx(
        (-limits.angular, limits.angular), rel=0.2
    )
    assert ((linear == 0.0) & (angular != 0.0)).any()
    assert ((linear != 0.0) & (angular == 0.0)).any()


def fastest_points(lab: Lockstep, rows: list[int], seconds: float) -> Array:
    """The highest speed of a point of each robot's outline while no contact pushed the robot."""
    world, fastest = lab.world, np.zeros(len(rows))
    pushed_at = dict.fromkeys(world.ids, -1.0)
    for _ in range(round(seconds / world.dt)):
        lab.advance(world.dt)
        for contact in world.contacts():
            pushed_at[contact.a] = pushed_at[contact.b] = world.time
        for number, row in enumerate(rows):
            if world.time - pushed_at[world.ids[row]] > 0.5:
                x, y = world.platforms[row].footprint.T
                linear, angular, lateral = world.twists()[row]
                speeds = np.hypot(linear - angular * y, lateral + angular * x)
                fastest[number] = max(fastest[number], float(speeds.max()))
    return fastest


@pytest.mark.parametrize(
    ("family", "platform"),
    [
        ("ram", "burger"),
        ("lead_fast", "waffle_pi"),
        pytest.param("lead", "jackal", marks=pytest.mark.evidence),
        pytest.param("spin", "burger", marks=pytest.mark.evidence),
    ],
)
def test_attackers_move_at_the_speed_of_their_cell(family: str, platform: str) -> None:
    scene = Scene(family, platform, mode="off")
    lab = Lockstep(scenario(scene), 1)
    platforms = lab.world.platforms
    rows = [row for row, one in enumerate(platforms) if one.name.startswith(ATTACKERS)]
    speed = attack_speed(scene, platform)
    assert speed == scene.of.speed * load_platform(platform).protection["barrier"]["others_speed"]
    fastest = fastest_points(lab, rows, 5.0)
    assert (fastest <= 1.02 * speed).all()  # the servo of a base overshoots a little
    if family != "spin":  # its corners add both parts only where they are parallel
        assert (fastest >= 0.99 * speed).all()


@pytest.mark.parametrize(
    ("family", "duration"),
    [
        ("ram", 4.0),  # the first hits of all families but spin are the same
        ("spin", 4.0),
        *(pytest.param(f, 20.0, marks=pytest.mark.evidence) for f in ATTACKING),
    ],
)
def test_attackers_drive_into_unprotected_robots(family: str, duration: float) -> None:
    trace = run(Scene(family, "burger", mode="off", duration=duration))
    attack = {trace.ids.index(robot) for robot in attackers(trace)}
    hits = [
        speed
        for pair, speeds in zip(trace.contact_pair.tolist(), trace.contact_speed, strict=True)
        for robot, speed in zip(pair, speeds, strict=True)
        if robot in attack and pair[1] >= 0 and not attack >= set(pair)
    ]
    assert max(hits) > 0.1


@pytest.mark.parametrize("family", ["box_along_wall", "leaf"])
def test_movers_stand_and_then_move_at_the_speed_of_their_cell(family: str) -> None:
    scene = Scene(family, "burger", mode="ghost")
    movers = scene.of.movers
    assert movers is not None
    lab = Lockstep(scenario(scene), 1)
    rows = [i for i, one in enumerate(lab.world.platforms) if one.name.startswith(ATTACKERS)]
    assert len(rows) == len(movers.places) == scene.attackers
    begin = lab.world.poses()[rows]
    lab.advance(movers.rests - 1.0)
    assert np.abs(lab.world.poses()[rows] - begin).max() < 1e-3
    fastest = fastest_points(lab, rows, 2.0)
    assert fastest == pytest.approx(attack_speed(scene, "burger"), rel=0.03)


@pytest.mark.parametrize("platform", ["burger", "jackal", "mixed"])
def test_a_wall_that_stands_is_longer_than_each_robot_of_the_scene(platform: str) -> None:
    robots = scenario(Scene("goals", platform, mode="walls_stand")).robots.values()
    longest = max(float(np.hypot(*np.ptp(one.footprint, axis=0))) for one in robots)
    declared = {one.protection["barrier"]["walls_stand"]["length"] for one in robots}
    assert len(declared) == 1
    assert declared.pop() > longest


@pytest.mark.parametrize(
    ("platform", "visibility", "foot"),
    [("turtlebot4", "real", 0.05), ("burger", "body", 0.0), ("mixed", "real", 0.05)],
)
def test_a_declared_foot_is_at_most_the_unseen_extent(
    platform: str, visibility: str, foot: float
) -> None:
    robots = scenario(Scene("goals", platform, visibility, mode="walls_foot")).robots.values()
    walls = [one.protection["barrier"]["walls_stand"] for one in robots]
    assert {(wall["length"], wall["foot"]) for wall in walls} == {(1.0, foot)}
