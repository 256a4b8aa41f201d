"""The kernel of a robot's ticks: the same compiled and interpreted, for one robot and for many."""

from __future__ import annotations

import ast
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core.events import (
    TICK_INPUT,
    DriverInput,
    HostInput,
    OdometryInput,
    RequestInput,
    ScanInput,
)
from swarmd.core.host_messages import Loaded, Step, Stepped
from swarmd.core.messages import Reason
from swarmd.core.values import Odometry, Outputs, Pose, Twist
from swarmd.core.verbs import RunRequest
from swarmd.robot.actions import Actions
from swarmd.robot.issue_time import IssueTime
from swarmd.robot.pattern_load import Loading, Wish
from swarmd.robot.robot import Robot
from swarmd.robot.setup import RobotSetup
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import Disc, scan_of
from tests.support.kernel_forms import both_forms, compares_forms
from tests.support.robot_harness import acted

if TYPE_CHECKING:
    from swarmd.robot.pattern_run import PatternRun

from swarmd.steering.steering import Steering

PLATFORM = load_platform("waffle_pi")
AXES = ("linear", "angular", "lateral")
FORMS = both_forms("swarmd.robot.ticker")


def said(run: PatternRun, now: float) -> tuple[object, ...]:
    return run.next_deadline(now), run.is_expired(now), run.is_restarting, run.restarts


def do(run: PatternRun, chance: Random, now: float) -> object:
    """One event of a run, chosen at random, and what it gives."""
    match chance.randrange(9):
        case 0:
            since, start = now - chance.random(), chance.choice((None, now + 0.2))
            wish, seconds = Wish(IssueTime(since), "alice"), chance.choice((None, 0.7))
            run.loading = Loading(1, "drive", {}, seconds, since, None, wish, start_at=start)
        case 1 if run.loading is not None:
            run.ready(Loaded(1, chance.choice((4.0, 20.0)), frozenset(), {}), now)
        case 2 if run.running is not None:
            run.stepped(Outputs(Twist(0.1)), 3, now)
        case 3:
            return run.fault(now)
        case 4:
            run.end_running()
        case _:
            is_due = run.may_step(now, chance.random() < 0.2)
            return run.stepping(now) if is_due else None
    return None


@compares_forms
def test_a_run_is_the_same_compiled_and_interpreted() -> None:
    runs, now = [kernel.PatternRun() for kernel in FORMS], 10.0
    steps = 0
    for seed in range(4000):
        now += Random(seed).choice((0.0, 0.01, 0.1, 0.5))
        one, other = (do(run, Random(seed), now) for run in runs)
        assert one == other
        assert said(runs[0], now) == said(runs[1], now)
        steps += isinstance(one, float)
    assert steps > 100


@compares_forms
def test_attributes_begin_as_the_same_values_compiled_and_interpreted() -> None:
    """A host reads a bool of the wire where it expects one, and no number."""
    for name in ("PatternRun", "InputAges", "DutyCycle"):
        one, other = (getattr(kernel, name)() for kernel in FORMS)
        words = [word for word in dir(one) if not word.startswith("__")]
        words = [word for word in words if not callable(getattr(other, word, print))]
        assert all(type(row).__name__ == "Hold" for row in getattr(one, "holds", ()))
        words = [word for word in words if "hold" not in word]
        begun = [[repr(getattr(each, word)) for word in words] for each in (one, other)]
        assert begun[0] == begun[1]


@compares_forms
def test_the_holds_of_inputs_are_the_same_compiled_and_interpreted() -> None:
    times, found = [kernel.InputAges() for kernel in FORMS], set[Reason | None]()
    chance = Random(1)
    for _ in range(4000):
        rows: dict[str, tuple[float, float]] = {
            "lost_hold": (chance.choice((np.inf,) * 9 + (-np.inf,)), np.inf),
            "base_hold": (chance.choice((np.inf,) * 9 + (-np.inf,)), np.inf),
            "hazard_hold": (-np.inf, chance.choice((-np.inf, -np.inf, 10.1))),
            "ring_hold": (chance.choice((-np.inf, np.inf, np.inf, 9.9, 10.5)), np.inf),
            "odometry_hold": (chance.choice((-np.inf, 9.9, 10.0, 10.4, np.inf)), np.inf),
            "peers_hold": (chance.choice((np.inf, 9.9)), np.inf),
            "pose_hold": (chance.choice((np.inf, 9.9, 10.2)), np.inf),
        }
        values: dict[str, Any] = {
            "_scan_at": chance.choice((-np.inf, 9.2, 9.4, 9.7, 9.9, 10.0)),
            "_added": chance.choice((0.0, 0.1, 0.25)),
            "_is_late": chance.random() < 0.2,
            "_stale_after": 0.7,
            "_max_delay": 0.2,
            "_context": None,
        }
        permitted, answers = chance.choice((0.0, 0.3)), []
        for one in times:
            for name, value in values.items():
                setattr(one, name, value)
            for name, (begins, until) in rows.items():
                row = getattr(one, name)
                row.begins, row.until = begins, until
            one.base_hold.reason, one.scan_hold.reason = Reason.BASE_CONFLICT, Reason.STALE_SCAN
            one.time_scan()
            one.permit_delay(permitted)
            answers.append(
                (one.hold(10.0), one.hold_due_at(10.0), one.stale_at(), one.context(10.0))
            )
        assert answers[0] == answers[1]
        found.add(answers[0][0])
    assert len(found) == 10


def running_robot() -> tuple[Robot, float]:
    settings = RobotSetup(driver="story")
    robot, now = (
        Robot("r", PLATFORM, settings, make_steering=Steering, seed=1, instance="b", now=10.0),
        10.0,
    )
    robot.step(DriverInput(True, "there"), now)
    robot.step(ScanInput(scan_of(PLATFORM, [Disc(1.0, 0.1)], room=4.0, seq=0)), now)
    robot.step(OdometryInput(Odometry(0.0, Pose(), Twist())), now)
    return robot, now


def follow(robot: Robot, actions: Actions, now: float) -> Twist:
    """The last command once the pattern host has answered."""
    while isinstance(actions.host, Step):
        stepped = Stepped(robot.generation, Outputs(Twist(0.2)), 1)
        actions = acted(robot, HostInput(stepped), now)
    return actions.twist


def test_many_robots_tick_as_one_does() -> None:
    (one, now), (other, _) = running_robot(), running_robot()
    commands, quiet = np.zeros((3, 3)), 0
    for robot in (one, other):
        run = RunRequest(id="q", operator="o", targets={"r": robot.epoch}, pattern="drive")
        robot.step(RequestInput(run), now)
        follow(robot, acted(robot, HostInput(Loaded(1, 10.0, frozenset(), {})), now), now)
    for number in range(1, 40):
        now += 0.05
        if number % 4 == 0:
            scan = scan_of(PLATFORM, [Disc(1.0, 0.1)], room=4.0, seq=number, noise=1e-6)
            for robot in (one, other):
                follow(robot, acted(robot, ScanInput(scan), now), now)
        odometry = Odometry(now, Pose(0.002 * number), Twist(0.04))
        one.step(OdometryInput(odometry), now)
        FORMS[1].odometry_many([None, other], [None, odometry], now)
        single = acted(one, TICK_INPUT, now)
        several = FORMS[1].tick_many([other], [2], commands, now)
        twist = follow(one, single, now)
        if several:
            commands[2] = tuple(getattr(follow(other, several[0][1], now), name) for name in AXES)
        assert single.is_quiet is (not several)
        assert commands[2].tolist() == [getattr(twist, name) for name in AXES]
        assert one.decision == other.decision
        quiet += single.is_quiet
    assert 10 < quiet < 39
    assert not commands[:2].any()


def test_actions_are_made_of_locals_that_have_the_names_of_their_fields() -> None:
    """They are given by position, so that two of them could be exchanged unnoticed."""
    source = Path(__file__).parents[2] / "swarmd" / "robot" / "ticker.py"
    calls = [
        node
        for node in ast.walk(ast.parse(source.read_text()))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "_Actions"
    ]
    fields = Actions.__struct_fields__
    for call in calls:
        assert tuple(map(ast.unparse, call.args)) == fields[: len(call.args)]
    assert sorted(len(call.args) for call in calls) == [6, len(fields)]
