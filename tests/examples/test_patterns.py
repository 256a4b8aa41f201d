"""The example patterns, found and loaded as a user's own files would be."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.values import Detection, Inputs, TouchZone, Twist
from swarmd.kit.behavior import Pattern
from swarmd.kit.touch import effective_zone
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import find_pattern
from swarmd.settings.settings import load_platform
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_of

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
BURGER = load_platform("burger")


def load(name: str) -> type[Pattern[Any]]:
    origin = find_pattern(name, EXAMPLES)
    return PatternLoader({name: (origin.value, origin.is_file)})(name)


class TestApproachTag(PatternContract):
    pattern = load("approach_tag")


class TestBeeclust(PatternContract):
    pattern = load("beeclust")


class TestPush(PatternContract):
    pattern = load("push")


class TestShy(PatternContract):
    pattern = load("shy")


class TestWaitingWalk(PatternContract):
    pattern = load("waiting_walk")


@pytest.mark.parametrize(("temperature", "seconds"), [(20.0, 0), (25.0, 6), (1000.0, 12)])
def test_a_walk_waits_at_a_meeting_the_longer_the_warmer(temperature: float, seconds: int) -> None:
    platform = TestWaitingWalk.subject("burger").platform
    pattern = Subject(load("waiting_walk"), platform, {"wait": 12.0}).make()
    readings, states = {"temperature": temperature}, []
    for k in range(14):
        near = [Disc(0.3, 0.0)] if k == 0 else []
        scan = scan_of(platform, near, seq=k)
        states.append(pattern.step(Inputs(float(k), 1.0, scan, readings=readings)).report["state"])
    assert states.count("wait") == seconds
    assert states[:seconds] == ["wait"] * seconds


@pytest.mark.parametrize(
    ("found", "twist"),
    [
        ((), Twist(angular=0.5)),
        ((Detection("robot", 0.0, 1.0),), Twist(angular=0.5)),
        ((Detection("box", 0.5, 2.0), Detection("box", 0.0, 3.0)), Twist(0.05, 0.5)),
        ((Detection("box", 2.0, 2.0),), Twist(angular=2.0)),
        ((Detection("box", 0.1), Detection("box", 0.5, 2.0)), Twist(0.05, 0.5)),
        ((Detection("box", 0.1),), Twist()),
        ((Detection("box", 0.1, 0.7),), Twist()),
    ],
)
def test_a_robot_drives_to_the_nearest_tag_and_stops(
    found: tuple[Detection, ...], twist: Twist
) -> None:
    pattern = Subject(
        load("approach_tag"),
        TestApproachTag.subject("burger").platform,
        {"speed": 0.1, "kind": "box"},
    )
    inputs = Inputs(0.0, 0.0, scan_of(BURGER), detections=found)
    assert pattern.make().step(inputs).twist == twist


def test_a_turtlebot4_drives_to_the_tag_that_its_camera_recognises() -> None:
    box: dict[str, Any] = {"name": "crate", "at": [1.0, 0.5], "size": [0.3, 0.3], "mass": 5.0}
    group = {
        "platform": "turtlebot4",
        "count": 1,
        "pattern": "approach_tag",
        "parameters": {"kind": "box"},
    }
    data = {
        "duration": 20,
        "arena": {"size": [5.0, 5.0], "boxes": [box]},
        "groups": {"all": {**group, "start": {"layout": "list", "poses": [[-1.5, 0.0, 2.0]]}}},
    }
    trace = simulate_run(scenario_of({**data, "plugin_dir": str(EXAMPLES)}), 0)
    assert math.dist(trace.pose[-1, 0, :2], box["at"]) == pytest.approx(0.8, abs=0.1)
    assert not len(trace.contact_t)


def test_the_grant_in_the_docstring_of_push_covers_its_zone() -> None:
    granted = TouchZone(0.0, math.radians(20.0), 0.1)  # as its docstring configures it
    assert "touch: {push: {half_width_deg: 20, speed: 0.1}}" in (EXAMPLES / "push.py").read_text()
    assert effective_zone("push", TestPush.pattern.touches, granted)[0] == granted
    assert TestPush.pattern.params_type().recovery is False


@pytest.mark.parametrize(
    ("disc", "twist"),
    [
        (Disc(2.0, 0.0), Twist(linear=0.15)),
        (Disc(0.5, 0.2), Twist(angular=1.0)),
        (Disc(0.5, -0.2), Twist(angular=1.0)),
        (Disc(-0.5, 0.2), Twist(linear=0.15)),
    ],
)
def test_shy_turns_while_something_is_near_ahead(disc: Disc, twist: Twist) -> None:
    pattern = Subject(TestShy.pattern, BURGER, {}).make()
    assert pattern.step(Inputs(now=0.0, dt=0.0, scan=scan_of(BURGER, [disc]))).twist == twist


def test_five_shy_robots_never_get_stuck() -> None:
    start = {"layout": "random", "clearance": 0.3}
    group = {"platform": "burger", "count": 5, "pattern": "shy", "start": start}
    data = {"duration": 30, "arena": {"size": [6.0, 6.0]}, "groups": {"shy": group}}
    trace = simulate_run(scenario_of({**data, "plugin_dir": str(EXAMPLES)}), 0)
    steps = np.hypot(*np.diff(trace.pose[..., :2], axis=0).T).T
    assert steps.reshape(3, -1, 5).sum(axis=1).min() > 0.2  # m within ten seconds


def test_beeclust_robots_wait_where_it_is_warm() -> None:
    """Robots whose waits do not depend on the temperature spend 0.64 of them in the warm half."""
    path = str(EXAMPLES / "beeclust.yaml")
    trace = simulate_run(load_scenario(path, {"duration": 20}), 3)
    is_waiting = trace.words["state"] == "wait"
    assert is_waiting.sum() > 1000
    assert (trace.pose[is_waiting][:, 0] > 0.0).mean() > 0.9  # 0.99


@pytest.mark.evidence
def test_beeclust_gathers_in_the_warm_spot() -> None:
    """In one run of twelve robots chance may lead more of them to the cold half."""
    shares = []
    for seed in range(4):
        trace = simulate_run(load_scenario(str(EXAMPLES / "beeclust.yaml")), seed)
        late = trace.pose[trace.t > 60.0, :, :2]
        shares.append([(np.hypot(*(late - (x, 0.0)).T) < 1.0).mean() for x in (1.5, -1.5)])
    warm, cold = np.mean(shares, axis=0)
    assert warm > 1.75 * cold  # 2.3 times; without waiting 1.2 times


def test_beeclust_waits_for_robots_alone_and_for_as_long_as_it_is_warm() -> None:
    def state_after(seconds: float, disc: Disc, temperature: float) -> object:
        platform = replace(BURGER, provides=BURGER.provides | {"reading:temperature"})
        pattern = Subject(TestBeeclust.pattern, platform, {}).make()
        scan, readings = scan_of(BURGER, [disc]), {"temperature": temperature}
        pattern.step(Inputs(now=0.0, dt=0.0, scan=scan, readings=readings))
        after = Inputs(now=seconds, dt=seconds, scan=scan_of(BURGER), readings=readings)
        return pattern.step(after).report["state"]

    robot, wall = Disc(0.4, 0.1), Disc(1.4, 0.0, 1.0)
    assert [state_after(10.0, robot, degrees) for degrees in (36.0, 20.0)] == ["wait", "drive"]
    assert state_after(119.0, robot, 36.0) == "drive"  # 109 s and a turn of at most 4.7 s
    assert [state_after(1.4, wall, degrees) for degrees in (36.0, 20.0)] == ["turn", "turn"]
