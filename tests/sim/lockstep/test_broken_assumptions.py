"""What robots say when an assumption of docs/safety.md does not hold.

Where a robot cannot know, the row is empty: the page says so, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from studies.safety.scenes import PLUGINS
from swarmd.core.messages import Reason, State
from swarmd.robot.robot import Robot
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenariofile import scenario_of
from tests.support.broken_assumptions import give_all, lose_rays

Break = Callable[[Lockstep], None]
_WALKER = {"linear": 1.5, "lateral": 1.5, "angular": 2.0}
PEDESTRIAN: dict[str, Any] = {
    "arena": {"size": [6.0, 6.0]},
    "lidar_visibility": "body",
    "plugin_dir": str(PLUGINS),
    "platforms": {
        "walker": {
            "extends": "waffle_pi",
            "limits": _WALKER,
            "scan": {"rate": 20.0, "range_min": 0.05, "near": "reported"},
            "protection": {"mode": "off"},
        }
    },
    "groups": {
        "own": {"platform": "burger", "count": 1, "pattern": "random_walk"},
        "walkers": {
            "platform": "walker",
            "count": 1,
            "pattern": "attack",
            "parameters": {"speed": 1.5, "way": "ram"},
        },
    },
    "accepts_faster": {"walker": "a person"},
    "accepts_unseen": {"walker": "a person"},
}
"""Something that does not tell its speed comes at 1.5 m/s, again and again."""


def realism(**parts: dict[str, float]) -> dict[str, Any]:
    return {"realism": {"preset": "realistic", **parts}}


blind = partial(lose_rays, share=1.0, half=math.pi, seed=1)
SLOW = {**realism(actuation={"delay": 0.2}), "duration": 60.0}
LATE = realism(lidar={"delay": 0.2})
WEAK = realism(actuation={"linear_acceleration": 0.7, "angular_acceleration": 2.1})


def said(robot: Robot, now: float) -> set[str]:
    """Holds, findings and events of a robot, and what `describe` shows of base and scans."""
    status = robot.status(now)
    if status.platform == "walker":
        return set()
    texts = [*status.findings, status.not_following, *(one.text for one in status.events)]
    words = "braked at", "came at", "the base responds", "have not returned"
    found = {word for word in words if any(word in text for text in texts)}
    if status.state is not State.RUNNING:  # a hold has lasted
        found.add(str(status.reason))
    if status.scan_delay is not None and status.scan_delay.added:
        found.add("late by")
    return found


@pytest.mark.short_rows(3)
@pytest.mark.parametrize(
    ("changes", "breaks", "expected"),
    [
        pytest.param({}, None, set(), id="all hold"),
        pytest.param(WEAK, None, {"braked at"}, id="1: brakes 30 % weaker"),
        pytest.param(SLOW, None, {"the base responds"}, id="1: 0.2 s from command to base"),
        pytest.param(PEDESTRIAN, None, {"came at"}, id="2: a pedestrian at 1.5 m/s"),
        pytest.param(
            {}, partial(give_all, scan="offset", offset=0.05), set(), id="6: ranges 5 cm long"
        ),
        pytest.param(
            {}, partial(give_all, odometry="scale", factor=0.9), set(), id="7: 10 % of scale"
        ),
        pytest.param(
            {}, partial(give_all, odometry="scale", factor=1.3), set(), id="7: 30 % of slip"
        ),
        pytest.param({}, blind, {Reason.INVALID_SCAN}, id="8: a blind sensor"),
        pytest.param(
            {"duration": 100.0},
            partial(lose_rays, share=1.0, half=math.radians(7.5), seed=1),
            {"have not returned"},
            id="8: a covered sector",
        ),
        pytest.param(LATE, None, {"late by"}, id="9: scans 0.2 s late"),
    ],
)
def test_a_robot_says_which_of_its_assumptions_does_not_hold(
    changes: dict[str, Any], breaks: Break | None, expected: set[str]
) -> None:
    """They hold for 5 s, or do not hold from the start where the scenario breaks them."""
    data: dict[str, Any] = {
        "duration": 40.0,
        **realism(),
        "arena": {"size": [4.0, 4.0]},
        "groups": {"own": {"platform": "burger", "count": 3, "pattern": "random_walk"}},
        "start": {"layout": "random", "clearance": 0.3},
        **changes,
    }
    lab = Lockstep(scenario_of(data), seed=4)
    lab.advance(5.0)
    if breaks is not None:
        breaks(lab)
    lab.advance(data["duration"] - 5.0)
    robots = [shell.robot for shell in lab.shells if shell is not None]
    found = [said(robot, data["duration"]) for robot in robots]
    assert set[str]().union(*found) == expected
