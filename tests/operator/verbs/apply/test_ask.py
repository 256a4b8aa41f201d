"""The changes that lead from a swarm to a swarm file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.goal import GoalState
from swarmd.core.messages import Param, Presence, State
from swarmd.operator.verbs.apply.ask import plan_of
from swarmd.settings.swarmfile import GoalSection, ParametersSection, SwarmFile, load_swarm
from tests.support.goals import goal_status, make_goal, member_with, view_of
from tests.support.statuses import make_member

DRIVE = GoalSection(pattern="drive", params={"speed": 0.2}, targets=["r*"])
GOAL = make_goal(4, params={"speed": 0.2}, targets=("r*",))
FILE = SwarmFile(labels={"red": ["r1"], "fast": ["r1", "r2"]}, goal=DRIVE)


def robot(name: str, labels: tuple[str, ...], state: GoalState | None = GoalState.RUNNING) -> Any:
    """A robot that holds GOAL."""
    reason = "" if state is GoalState.RUNNING else state and state.value
    return member_with(name, goal_status(GOAL, state=state, reason=reason or ""), labels=labels)


def test_a_swarm_that_is_as_the_file_wants_is_left_alone() -> None:
    plan = plan_of(FILE, view_of(robot("r1", ("fast", "red")), robot("r2", ("fast",))))
    assert plan.is_empty
    assert not plan.moves
    assert plan.lines == ()


def test_labels_that_differ_are_set_and_move_nothing() -> None:
    plan = plan_of(FILE, view_of(robot("r1", ()), robot("r2", ("fast",)), robot("x", ("old",))))
    assert plan.labels == {"r1": ("red", "fast"), "x": ()}
    assert not plan.moves


def test_a_label_that_names_no_known_robot_is_told() -> None:
    plan = plan_of(SwarmFile(labels={"r1": ["red"]}), view_of(robot("r1", ())))
    assert plan.is_empty
    assert plan.unknown == {"red": "labels.r1 names it, and no such robot is known"}


def test_a_file_without_labels_and_goal_leaves_both() -> None:
    assert plan_of(SwarmFile(), view_of(robot("r1", ("red",)))).is_empty


def test_another_goal_is_set_for_its_targets() -> None:
    file = SwarmFile(goal=GoalSection(pattern="flocking", targets=["label:red", "r3"]))
    view = view_of(robot("r1", ("red",)), robot("r2", ()), robot("r3", ()))
    plan = plan_of(file, view)
    assert plan.goal is not None
    assert plan.goal["pattern"] == "flocking"
    assert plan.targets == ("r1", "r3")
    assert plan.moves


def test_a_range_in_a_goal_is_that_of_the_command_line() -> None:
    goal = GoalSection(pattern="flocking", targets=["r[1-3]", "x-*", "label:red"])
    assert goal.content["targets"] == ("r1", "r2", "r3", "x-*", "label:red")


def test_targets_are_those_of_the_labels_to_come() -> None:
    file = SwarmFile(labels={"red": ["r2"]}, goal=GoalSection(pattern="a", targets=["label:red"]))
    assert plan_of(file, view_of(robot("r1", ("red",)), robot("r2", ()))).targets == ("r2",)


@pytest.mark.parametrize(
    "other",
    [
        {"params": {"speed": 0.1}},
        {"pattern": None, "params": {}},
        {"seconds": 60.0},
        {"until": ["done"]},
        {"on_join": "run", "valid": 60.0},
        {"targets": []},
    ],
    ids=str,
)
def test_a_goal_with_other_content_is_another_one(other: dict[str, Any]) -> None:
    wanted = {"pattern": "drive", "params": {"speed": 0.2}, "targets": ["r*"], **other}
    plan = plan_of(SwarmFile(goal=GoalSection(**wanted)), view_of(robot("r1", ())))
    assert plan.goal is not None
    assert plan.moves is (wanted["pattern"] is not None)


def test_a_robot_that_was_offered_the_goal_resumes_it_and_one_that_ended_does_not() -> None:
    view = view_of(
        robot("r1", ("red", "fast"), GoalState.OFFERED), robot("r2", ("fast",), GoalState.ENDED)
    )
    plan = plan_of(FILE, view)
    assert (plan.goal, plan.resume) == (None, ("r1",))
    assert plan.left == {"r2": "ended"}
    assert plan.moves


def test_parameters_of_running_robots_that_differ_are_set() -> None:
    sections = ParametersSection(
        labels={"red": {"drive": {"speed": 0.1, "turn": 0.3}}},
        robots={"r1": {"drive": {"turn": 0.5}}, "r3": {"drive": {"speed": 0.1}}},
    )
    params = {"speed": Param(value=0.2, source="request"), "turn": Param(value=0.5, source="x")}
    view = view_of(
        make_member("r1", params=params, labels=("red",)),
        make_member("r2", params=params, labels=("red",)),
        make_member("r3", params=params, labels=(), state=State.STOPPED),
    )
    plan = plan_of(SwarmFile(parameters=sections), view)
    assert plan.params == {"r1": {"speed": 0.1}, "r2": {"speed": 0.1, "turn": 0.3}}
    of_goal = SwarmFile(parameters=sections, goal=DRIVE)
    held = view_of(member_with("r1", goal_status(GOAL), params=params, labels=("red",)))
    assert plan_of(of_goal, held).params == {}  # those of the goal count more


def test_a_robot_without_a_status_is_not_compared() -> None:
    view = view_of(robot("r1", ()), make_member("r2", Presence.FAILED), roster=("r3",))
    plan = plan_of(SwarmFile(goal=DRIVE), view)
    assert plan.unknown.keys() == {"r2", "r3"}
    assert plan.targets == ("r1",)


@pytest.mark.parametrize(
    ("goal", "subject"),
    [
        ("{patern: drive}", "'pattern'"),
        ("{pattern: Drive!}", "goal.pattern"),
        ("{pattern: drive, until: [nerer:1]}", "nearer"),
        ("{pattern: drive, on_join: run}", "valid"),
        ("{pattern: drive, valid: 60}", "on_join"),
        ("{pattern: drive, targets: [label:Red]}", "label:red"),
        ("{pattern: drive, targets: [tb3 *]}", "tb3"),
    ],
)
def test_a_fault_of_the_goal_is_one_line(tmp_path: Path, goal: str, subject: str) -> None:
    path = tmp_path / "swarm.yaml"
    path.write_text(f"swarm: lab\ngoal: {goal}\n")
    with pytest.raises(ConfigError, match=subject) as found:
        load_swarm(path, {}, {})
    assert "goal" in str(found.value)
    assert "\n" not in str(found.value)
