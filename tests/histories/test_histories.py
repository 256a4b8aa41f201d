"""Random histories of a swarm; see `invariants.py` for what must hold.

A history that fails is shrunk and printed as the `replay` that repeats it.
"""

from __future__ import annotations

import logging
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.events import DriverInput, Input, RequestInput, decode_input, encode_input
from swarmd.core.goal import HeldGoal
from swarmd.core.kernels import describe_kernels
from swarmd.core.message_limits import SenderLimits
from swarmd.core.values import Twist
from swarmd.link import peer
from swarmd.operator.session.clocks import RobotClocks
from swarmd.robot import state
from swarmd.robot.actions import Actions
from swarmd.robot.issue_time import IssueTime
from swarmd.robot.protection.fence import fence_pose
from swarmd.robot.requests import RequestHandler
from swarmd.robot.robot import Robot
from tests.histories import swarm
from tests.histories.history import History, Steps, draw, fault_of, replay, script, shrink, step
from tests.histories.invariants import HISTORIES, BrokenRuleError, Invariants

BLOCK = 25
IN_SUITE, IN_EVIDENCE = range(0, 100, BLOCK), range(100, HISTORIES, BLOCK)


def check(seed: int) -> None:
    """Replay the history with this seed; if it fails, fail with its shortest form."""
    count, steps = draw(seed)
    fault = fault_of(count, steps, seed)
    if fault is not None:
        count, steps = shrink(count, steps, fault.rule, seed)
        form = f"seed {seed}, kernels {describe_kernels()}"
        pytest.fail(f"{form}: {fault}\n{script(count, steps, seed)}", pytrace=False)


@pytest.mark.parametrize(
    "first",
    [*IN_SUITE, *(pytest.param(first, marks=pytest.mark.evidence) for first in IN_EVIDENCE)],
)
def test_histories_break_no_rule(first: int) -> None:
    for seed in range(first, first + BLOCK):
        check(seed)


def test_a_run_that_arrives_after_a_later_stop_may_be_ended_by_it() -> None:
    """The operator repeats both: the request of the run passes the cut first."""
    history = (
        step(0.0, "run", by="anna", valid=60.0),
        step(0.05, "split", groups=(("anna", "r3"), ("bob", "r4"), ("r1", "r2"))),
        step(5.61, "stop", by="anna"),
        step(2.32, "heal"),
    )
    assert fault_of(2, history, 3158) is None


def test_a_history_repeats() -> None:
    """The same seed gives the same events, so that what is printed repeats a failure."""
    lines = []
    for _ in range(2):
        history = replay(*draw(11), seed=11)
        robots = history.swarm.robots.values()
        lines.append([one.robot.status(history.swarm.now).events for one in robots])
    assert lines[0] == lines[1]


class RecordedRobot(Robot):
    """A robot, and a second one that gets the same inputs by their bytes, as a replay does."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._replayed = Robot(*args, **options)

    def step(self, input: Input, now: float) -> Actions | None:
        """As `Robot.step`; both robots act and think alike."""
        actions = super().step(input, now)
        again = self._replayed.step(decode_input(encode_input(input)), now)
        assert bits_of(actions) == bits_of(again)
        assert self.status(now) == self._replayed.status(now)
        return actions


def bits_of(actions: Actions | None) -> bytes:
    """The actions with all that they hold, arrays included."""

    def plain(value: Any) -> Any:
        return value.tobytes() if isinstance(value, np.ndarray) else dict(value)

    return msgspec.msgpack.encode(actions, enc_hook=plain)


def test_the_bytes_of_inputs_repeat_each_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(swarm, "Robot", RecordedRobot)
    for seed in range(8):
        check(seed)


class FaultyRobot(Robot):
    """A robot that breaks the rule `broken`."""

    broken = ""

    @property
    def goal(self) -> HeldGoal | None:
        """The goal that it holds."""
        return None if self.broken == "order" and not self.is_running else super().goal

    def step(self, input: Input, now: float) -> Actions | None:
        """As `Robot.step`, with a fault."""
        actions = super().step(input, now)
        if self.broken == "zero" and actions is not None and not self.is_running:
            return replace(actions, twist=Twist(0.1))
        if self.broken == "exception" and isinstance(input, RequestInput):
            raise ValueError
        elif self.broken == "logged" and isinstance(input, RequestInput):
            logging.getLogger("swarmd.robot").error("it failed", exc_info=ValueError())
        return actions


@pytest.mark.parametrize(
    ("broken", "rule"),
    [
        ("", None),
        ("order", "order"),
        ("zero", "zero"),
        ("exception", "exception"),
        ("logged", "exception"),
    ],
)
def test_a_fault_breaks_its_rule(
    monkeypatch: pytest.MonkeyPatch, broken: str, rule: str | None
) -> None:
    monkeypatch.setattr(FaultyRobot, "broken", broken)
    monkeypatch.setattr(swarm, "Robot", FaultyRobot)
    fault = fault_of(2, [step(0.0, "run", by="anna"), step(2.0, "stop", by="bob")])
    assert (None if fault is None else fault.rule) == rule


@pytest.mark.parametrize(("believes", "rule"), [(False, None), (True, "still_pose")])
def test_a_fence_that_believes_a_pose_that_stands_still_breaks_a_rule(
    monkeypatch: pytest.MonkeyPatch, *, believes: bool, rule: str | None
) -> None:
    if believes:
        monkeypatch.setattr(fence_pose, "_agree", lambda *_: True)
    steps = (
        step(0.0, "run", by="anna"),
        step(2.0, "freeze_pose", robot="r1", seconds=60.0),
        step(6.0, "heal"),
    )
    fault = fault_of(1, steps)
    assert (None if fault is None else fault.rule) == rule


class ResumingRobot(Robot):
    """A robot whose run goes on when its base is back, however long the base was lost."""

    def step(self, input: Input, now: float) -> Actions | None:
        """As `Robot.step`, but a lost base counts as connected."""
        is_loss = isinstance(input, DriverInput) and not input.is_up
        return super().step(DriverInput(True, "connected") if is_loss else input, now)


@pytest.mark.parametrize(("kind", "rule"), [(Robot, None), (ResumingRobot, "lost_base")])
def test_a_robot_that_commands_a_lost_base_breaks_a_rule(
    monkeypatch: pytest.MonkeyPatch, kind: type[Robot], rule: str | None
) -> None:
    monkeypatch.setattr(swarm, "Robot", kind)
    loss = step(2.0, "lose_base", robot="r1", seconds=6.0)
    fault = fault_of(2, [step(0.0, "run", by="anna"), loss, step(9.0, "stop", by="bob")])
    assert (None if fault is None else fault.rule) == rule


def test_a_run_that_outlives_a_long_loss_of_its_base_breaks_a_rule(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(state, "MAX_HOLD_TIME", 60.0)
    loss = step(2.0, "lose_base", robot="r1", seconds=6.0)
    fault = fault_of(2, [step(0.0, "run", by="anna"), loss, step(9.0, "stop", by="bob")])
    assert fault is not None
    assert fault.rule == "lost_base"


LATE = (
    step(0.0, "kill", robot="r2"),
    step(0.1, "run", by="anna"),
    step(0.5, "sleep", by="anna", seconds=20.0, is_noticed=False),
    step(25.0, "heal"),
)
CLONED = (
    step(0.0, "clone", by="bob", shift=600.0),
    step(0.1, "run", by="bob"),
    step(3.0, "stop", by="anna"),
)
SET_BACK = (
    step(0.1, "run", by="bob"),
    step(2.0, "set_back", by="bob", seconds=30.0),
    step(2.0, "stop", by="bob"),
)
RUN_OF_A_CLONE = (
    step(0.0, "clone", by="bob", shift=30.0),
    step(0.0, "kill", robot="r2"),
    step(0.1, "run", by="bob"),
    step(0.3, "stop", by="anna"),
)


@pytest.mark.parametrize(
    ("steps", "owner", "method", "rule"),
    [
        (LATE, RequestHandler, "_refusal_of_wish", "late_start"),
        (CLONED, IssueTime, "is_surely_before", "stopped"),
        (SET_BACK, IssueTime, "is_surely_before", "stopped"),
        (RUN_OF_A_CLONE, IssueTime, "is_before", "stopped"),
    ],
    ids=["late", "cloned", "set back", "run of a clone"],
)
def test_a_robot_that_believes_the_clock_of_an_operator_breaks_a_rule(
    monkeypatch: pytest.MonkeyPatch, steps: Steps, owner: type, method: str, rule: str
) -> None:
    assert fault_of(2, steps) is None
    if owner is IssueTime:
        monkeypatch.setattr(IssueTime, method, lambda one, other: one.issued < other.issued)
    else:
        monkeypatch.setattr(owner, method, lambda *_: None)
    fault = fault_of(2, steps)
    assert fault is not None
    assert fault.rule == rule


@pytest.mark.parametrize("end", ["die", "end_loop", "sleep"])
def test_a_run_ends_with_the_program_that_renews_its_lease(end: str) -> None:
    seconds = {"seconds": 60.0} if end == "sleep" else {}
    history = History(2)
    for one in (
        step(0.0, "run", by="anna", lease=2.0, here=100.0),
        step(8.0, end, by="anna", **seconds),
    ):
        history.carry_out(one)
    robots = history.swarm.robots.values()
    assert all(one.robot.is_running for one in robots)
    history.swarm.advance(2.5)
    assert not any(one.robot.is_running for one in robots)


def test_a_run_without_a_goal_has_no_lease() -> None:
    """It follows a run that ended with its lease; the judge took it for that one."""
    history = (
        step(0.05, "run", by="bob", lease=2.0, here=8.0),
        step(0.5, "clone", by="bob", shift=30.0),
        step(2.26, "run", by="anna", has_goal=False),
    )
    assert fault_of(2, history, 783) is None


def test_a_fork_commands_and_the_lease_of_its_parent_goes_on() -> None:
    history = History(2)
    for one in (
        step(0.0, "run", by="anna", lease=2.0, here=100.0),
        step(4.0, "fork", by="anna"),
        step(1.0, "stop", by="anna-child", targets=("r1",)),
        step(5.0, "heal"),
    ):
        history.carry_out(one)
    robots = history.swarm.robots.values()
    assert [one.robot.state for one in robots] == ["stopped", "running"]
    history.carry_out(step(0.0, "die", by="anna"))
    history.swarm.advance(2.5)
    assert [one.robot.state for one in robots] == ["stopped", "stopped"]


LEASED = {"by": "anna", "lease": 2.0, "here": 8.0, "on_join": "run", "valid": 300.0}


@pytest.mark.parametrize(
    "victim",
    [
        (step(0.05, "boot", robot="r3"), step(0.0, "play_back", robot="r3")),
        (step(0.05, "start", robot="r1", disk="empty"), step(0.0, "play_back", robot="r1")),
        (step(0.05, "start", robot="r1"), step(0.0, "play_back", robot="r1")),
        (step(0.05, "heal"), step(0.0, "play_back", robot="r1", period=1.0, newest=4)),
    ],
    ids=["joins late", "starts anew", "restarts", "after a split"],
)
def test_a_recorded_lease_lets_no_robot_of_a_secured_swarm_drive(victim: Steps) -> None:
    """Counts 1, 2, 3 and so on, each with a valid signature, once the operator is dead."""
    steps = (
        step(0.0, "run", **LEASED),
        step(3.0, "cut", senders=("anna",), receivers=("r1",)),
        step(1.5, "die", by="anna"),
        *victim,
        step(20.0, "heal"),
    )
    assert fault_of(2, steps, seed=2) is None


def test_a_robot_that_believes_a_replayed_lease_breaks_a_rule(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(peer, "lease_age", lambda *_: 0.0)
    steps = (
        step(0.0, "run", **LEASED),
        step(4.5, "die", by="anna"),
        step(0.05, "boot", robot="r3"),
        step(0.0, "play_back", robot="r3"),
        step(20.0, "heal"),
    )
    fault = fault_of(2, steps, seed=2)
    assert fault is not None
    assert fault.rule == "lease"


@pytest.mark.parametrize("seed", [1, 2], ids=["without keys", "secured"])
@pytest.mark.parametrize(
    "events",
    [
        (step(0.5, "disturb", loss=0.1), step(20.0, "heal")),
        (step(0.5, "disturb", delay=0.3), step(20.0, "heal")),
        (step(2.0, "start", robot="r1"), step(20.0, "heal")),
        (step(2.0, "start", robot="r1", disk="empty"), step(20.0, "heal")),
        (step(2.0, "jump", by="anna", seconds=3600.0), step(20.0, "heal")),
        (step(2.0, "jump", by="anna", seconds=-3600.0), step(20.0, "heal")),
        (step(2.0, "wall", robot="anna", shift=1e6), step(20.0, "heal")),
        (step(2.0, "die", by="anna"), step(0.5, "run", **LEASED | {"here": 100.0})),
        (step(2.0, "split", groups=(("anna", "r1"), ("r2",))), step(1.5, "heal")),
    ],
    ids=["loss", "delay", "restart", "new_disk", "ahead", "back", "wall", "operator", "split"],
)
def test_an_operator_that_lives_keeps_its_robots_driving(events: Steps, seed: int) -> None:
    lease = {"lease": 5.0, "here": 100.0}
    history = History(2, seed)
    for one in (step(0.0, "run", **LEASED | lease), *events, step(10.0, "heal")):
        history.carry_out(one)
    robots = history.swarm.robots.values()
    assert [one.robot.state for one in robots] == ["running", "running"]


def test_a_robot_of_a_secured_swarm_tells_of_the_lease_of_an_older_operator(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An older version states no time: its leases prolong nothing, and the robot says so."""
    monkeypatch.setattr(RobotClocks, "reading", lambda *_: None)
    history = History(1, seed=2)
    for one in (step(0.0, "run", **LEASED | {"here": 100.0}), step(6.0, "heal")):
        history.carry_out(one)
    status = history.swarm.robots["r1"].robot.status(history.swarm.now)
    assert (status.state, status.reason) == ("stopped", "lease_ended")
    assert "older swarmctl" in status.detail


def test_no_start_is_sent_after_a_standstill_that_is_noticed() -> None:
    """A robot would refuse only a start of more than 5 s."""
    history = History(2)
    for one in (
        step(0.0, "kill", robot="r2"),
        step(0.1, "run", by="anna"),
        step(0.5, "sleep", by="anna", seconds=2.0),
        step(12.0, "heal"),
    ):
        history.carry_out(one)
    assert not history.swarm.robots["r1"].robot.is_running
    assert history.swarm.robots["r1"].robot.status(history.swarm.now).epoch.revision == 0


def test_messages_of_a_program_beyond_the_limits_break_a_rule(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(SenderLimits, "passes", lambda *_: True)
    fault = fault_of(2, [step(0.0, "put", by="anna", sender="teacher", count=200)])
    assert fault is not None
    assert fault.rule == "program"


def test_a_rule_that_breaks_within_a_request_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*args: Any) -> None:
        raise BrokenRuleError("answer", "a robot lies")

    monkeypatch.setattr(Invariants, "on_reply", broken)
    fault = fault_of(2, [step(0.0, "goal", by="anna")])
    assert fault is not None
    assert fault.rule == "answer"


def test_a_failing_history_is_shrunk(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot that forgets its latches when it restarts: three steps are enough to show it."""
    from tests.histories.swarm import VirtualDaemon

    start = VirtualDaemon.start

    def forgetful(daemon: VirtualDaemon, disk: object = None) -> None:
        start(daemon, type(daemon.disk)(goals=daemon.disk.goals))

    monkeypatch.setattr(VirtualDaemon, "start", forgetful)
    history = (
        step(0.0, "run", by="anna"),
        step(1.0, "estop", by="anna", targets=("r1",)),
        step(1.0, "boot", robot="r4"),
        step(0.5, "wall", robot="r2", shift=5.0),
        step(1.0, "start", robot="r1"),
        step(1.0, "run", by="bob"),
    )
    fault = fault_of(3, history)
    assert fault is not None
    assert fault.rule == "latch"
    count, steps = shrink(3, history, "latch")
    assert [one.name for one in steps] == ["estop", "start"]
    printed = script(count, steps)
    names = {"step": step, "replay": lambda count, steps, seed: fault_of(count, steps, seed)}
    assert eval(printed, names).rule == "latch"
