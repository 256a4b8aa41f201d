"""The kernel of a robot's ticks: the same compiled and interpreted, for one robot and for many."""

from __future__ import annotations

import ast
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from swarmd.core.events import (
    TICK_INPUT,
    DriverInput,
    HostInput,
    KinInput,
    MessageInput,
    NeighborsInput,
    OdometryInput,
    RequestInput,
    ScanInput,
)
from swarmd.core.goal import Goal
from swarmd.core.host_messages import Loaded, Step, Stepped
from swarmd.core.kin_message import KinMessage
from swarmd.core.messages import Reason, State
from swarmd.core.values import Neighbor, Odometry, Outputs, Pose, Twist
from swarmd.core.verbs import RunRequest
from swarmd.robot.actions import Actions
from swarmd.robot.issue_time import IssueTime
from swarmd.robot.pattern_load import Loading, Wish
from swarmd.robot.robot import Robot
from swarmd.robot.setup import RobotSetup
from swarmd.robot.steering.steering import Steering
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import Disc, empty_scan, scan_of
from tests.support.kernel_forms import both_forms, compares_forms
from tests.support.robot_harness import acted
from tests.support.stub_patterns import idle, standing_state, started

if TYPE_CHECKING:
    from swarmd.robot.pattern_run import PatternRun

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
        commands[2] = np.nan  # of the tick before
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


def test_no_tick_in_running_is_a_share_of_zero() -> None:
    assert [kernel.DutyCycle().share for kernel in FORMS] == [0.0, 0.0]


def test_the_share_of_active_protection_counts_ticks_in_running_alone() -> None:
    harness = idle()
    assert harness.robot._duty.decisions == 0
    harness.applied("run", pattern="forward")
    harness.advance(1.0)  # 20 ticks, and a wake-up for each of 10 steps
    assert 20 <= harness.robot._duty.decisions <= 30
    harness.applied("stop")
    counted = harness.robot._duty.decisions
    harness.advance(1.0)
    assert harness.robot._duty.decisions == counted


def test_the_first_tick_of_a_robot_looks_at_all_and_gives_a_status() -> None:
    robot = Robot(
        "r",
        PLATFORM,
        RobotSetup(driver="story"),
        make_steering=Steering,
        seed=1,
        instance="b",
        now=10.0,
    )
    actions = acted(robot, TICK_INPUT, 10.0)
    assert (actions.is_quiet, actions.has_status) == (False, True)


def test_a_change_of_state_is_told_at_the_next_tick() -> None:
    """robot.py: a status is due if a value that peers act on has changed, or after a second."""
    harness = idle()
    for verb, fields in (("run", {"pattern": "forward"}), ("stop", {}), ("reset", {})):
        while acted(harness.robot, TICK_INPUT, harness.now).has_status:
            harness.advance(0.05)
        harness.applied(verb, **fields)
        assert acted(harness.robot, TICK_INPUT, harness.now + 0.01).has_status


@pytest.mark.parametrize(("early", "twist"), [(1e-6, Twist()), (2e-6, Twist(0.2))])
def test_a_command_expires_a_microsecond_before_its_time_is_over(
    early: float, twist: Twist
) -> None:
    """A timer may wake a rounding error early (timeouts.py), and a command counts for 0.3 s."""
    harness = started()
    harness.is_hung = True
    running = harness.robot._run.running
    assert running is not None
    for after in (0.1, 0.21, 0.25):  # a step begins, the next one waits for its answer
        harness.step(TICK_INPUT, running.requested_at + after)
        assert harness.twist == Twist(0.2)
    harness.step(TICK_INPUT, running.requested_at + 0.3 - early)
    assert harness.twist == twist


# Between two regular ticks a robot wakes at four kinds of deadlines (`Ticker.wake_at`). The tests
# ask for a later time than that of the last input, when nearer deadlines are over.


def test_a_robot_wakes_just_after_its_scan_has_become_stale() -> None:
    """A scan of 5 Hz counts for 3.5 periods, which are 0.7 s (docs/failures.md)."""
    harness = started()
    harness.scan(empty_scan(PLATFORM, 100, harness.now))
    wake_at = harness.robot.wake_at(harness.now + 0.65)
    assert wake_at == pytest.approx(harness.now + 0.7001, abs=1e-6)


def test_a_robot_in_a_hold_wakes_when_the_hold_has_lasted_for_two_seconds() -> None:
    harness = started()
    harness.scans = lambda seq, now: None
    while harness.status.reason is not Reason.STALE_SCAN:
        harness.advance(0.05)
    began = harness.now - 0.05  # or since
    wake_at = harness.robot.wake_at(harness.now + 1.9)
    assert wake_at is not None
    assert began + 2.0 <= wake_at <= began + 2.05
    states = []
    for seconds in (1.9, 0.1):
        harness.advance(seconds)
        states.append(harness.robot.state)
    assert states == [State.RUNNING, State.STOPPED]


def test_a_robot_wakes_when_its_run_lease_ends() -> None:
    harness = idle()
    goal = Goal(generation=1, issuer="bob", id="g1", pattern="forward", lease=3.0)
    harness.applied("run", pattern="forward", goal=goal)
    assert harness.robot.wake_at(harness.now + 2.9) == pytest.approx(harness.now + 3.0)


def test_quiet_ticks_end_a_run_with_its_lease() -> None:
    harness = idle()
    goal = Goal(generation=1, issuer="bob", id="g1", pattern="forward", lease=3.0)
    harness.applied("run", pattern="forward", goal=goal)
    harness.advance(2.9)
    assert harness.twist == Twist(0.2)
    harness.advance(0.1)
    assert harness.twist.is_zero
    assert standing_state(harness) == (State.STOPPED, Reason.LEASE_ENDED)


def test_a_robot_that_stands_wakes_at_regular_ticks_alone() -> None:
    harness = idle()
    assert harness.robot.wake_at(harness.now) is None
    harness.applied("run", pattern="forward")
    assert harness.robot.wake_at(harness.now) is not None
    harness.applied("stop")
    assert harness.robot.wake_at(harness.now) is None


def test_actions_say_what_the_shell_may_do_with_a_command_in_each_state() -> None:
    """actions.py: idle with its base; stopped, estopped or faulted; without a run no scan."""
    harness = idle()

    def told() -> tuple[bool, bool, int]:
        actions = acted(
            harness.robot, RequestInput(harness.request("label", labels=("red",))), harness.now
        )
        return actions.is_idle, actions.is_stopped, actions.requested_scan_seq

    assert told() == (True, False, -1)
    harness.applied("run", pattern="forward")
    harness.advance(0.5)
    is_idle, is_stopped, scan_seq = told()
    assert (is_idle, is_stopped) == (False, False)
    assert scan_seq >= 0
    harness.applied("stop")
    assert told() == (False, True, -1)
    harness.applied("reset")
    harness.step(DriverInput(False, "gone"))
    assert told() == (False, False, -1)


def test_each_receiver_of_a_message_gets_it_and_who_is_none_is_skipped() -> None:
    harness = started("listener")
    message = MessageInput("r02", "listener/count", 7)
    harness.step(NeighborsInput((Neighbor("r02", 0.0),)))
    FORMS[1].message_many([None, harness.robot, None], message, harness.now)
    harness.advance(0.5)
    assert harness.status.report["heard"] == "(('r02', 7),)"
    idle_one = idle()
    idle_one.step(NeighborsInput((Neighbor("r02", 0.0),)))
    FORMS[1].message_many([idle_one.robot], message, idle_one.now)  # without a run none is kept
    idle_one.applied("run", pattern="listener")
    idle_one.advance(0.5)
    assert idle_one.status.report["heard"] == "()"


@pytest.mark.parametrize("asks", [True, False])
def test_who_hears_a_peer_that_asks_for_places_names_peers(asks: bool) -> None:
    harness = idle()
    told = KinInput("r02", KinMessage(1, 0, 0, 0, 0, b"", asks))
    hearing = FORMS[1].kin_many([None, harness.robot], told, harness.now)
    assert len(hearing) == asks
    assert (harness.robot._sensors.kin is not None) is asks


def test_a_robot_that_loads_a_pattern_is_not_at_rest() -> None:
    harness = idle()
    assert harness.robot.is_at_rest
    harness.is_hung = True
    assert harness.ask("run", pattern="forward") is None
    assert not harness.robot.is_at_rest
