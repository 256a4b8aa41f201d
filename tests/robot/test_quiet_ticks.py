"""Quiet ticks: a tick in which nothing is due gives what a tick that checks everything gives."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from swarmd.core.clock import TICK
from swarmd.core.events import (
    TICK_INPUT,
    DriverInput,
    DuplicateInput,
    HazardsInput,
    HostInput,
    Input,
    LatchesInput,
    MessageInput,
    NeighborsInput,
    NetworkInput,
    OdometryInput,
    ReadingsInput,
    RequestInput,
    RosterInput,
    ScanInput,
)
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.host_messages import (
    HostDied,
    HostEvent,
    Load,
    Loaded,
    LoadRefused,
    ParamsSet,
    PatternFailed,
    SetParams,
    StartTrial,
    Step,
    Stepped,
    TrialDone,
)
from swarmd.core.messages import Epoch, Latch, Reason
from swarmd.core.values import Neighbor, Odometry, Outputs, Pose, Twist
from swarmd.core.verbs import (
    EstopRequest,
    ParamRequest,
    ReloadRequest,
    Request,
    ResetRequest,
    RunRequest,
    StopRequest,
)
from swarmd.robot.actions import Actions
from swarmd.robot.robot import Robot
from swarmd.robot.setup import RobotSetup
from swarmd.robot.steering.steering import Steering
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import Disc, empty_scan, scan_of
from tests.support.examples import examples
from tests.support.platforms import with_mode
from tests.support.robot_harness import RobotHarness, acted
from tests.support.stub_patterns import started

PLATFORM = with_mode(load_platform("waffle_pi"), "stop_zone")  # with recovery, and cheap
COMMANDS = (Twist(0.2), Twist(0.0, 0.5), Twist(-0.1, -0.2), Twist(float("nan")), None)


class Restless(Robot):
    """A robot that checks everything at each event."""

    def step(self, input: Input, now: float) -> Actions | None:
        self._hold = Reason.NO_SCAN  # under a hold each tick looks at all
        return super().step(input, now)


class Pair:
    """A robot with quiet ticks and one without, to which the same happens."""

    def __init__(self) -> None:
        self.now, self.seq, self.count = 1000.0, 0, 0
        settings = RobotSetup(driver="story")
        self.robots = tuple(
            made(
                "r", PLATFORM, settings, make_steering=Steering, seed=1, instance="b", now=self.now
            )
            for made in (Robot, Restless)
        )
        self.is_answering = True
        self.takes_params = True
        self.quiet = 0
        self.do(DriverInput(True, "there"))

    def do(self, input: Input) -> None:
        """Hand the input to both, compare, and let the pattern host answer."""
        actions, checked = (acted(robot, input, self.now) for robot in self.robots)
        assert facts(actions) == facts(checked)
        assert not checked.is_quiet
        self.quiet += actions.is_quiet
        robot, other = self.robots
        assert robot.status(self.now) == other.status(self.now)
        assert robot.wake_at(self.now) == other.wake_at(self.now)
        if self.is_answering:
            for command in (checked.trial, checked.host):
                if isinstance(command, SetParams) and not self.takes_params:
                    continue
                if (answer := answer_to(command, self.seq)) is not None:
                    self.host_says(answer)

    def host_says(self, event: HostEvent) -> None:
        """The pattern host says so to both."""
        self.do(HostInput(event))

    def ask(self, kind: type[Request], **fields: Any) -> None:
        """Both are asked the same."""
        self.count += 1
        targets: dict[str, Epoch | None] = {"r": self.robots[0].epoch}
        request = kind(id=f"q{self.count}", operator="o", targets=targets, **fields)
        self.do(RequestInput(request))

    def scan(self, distance: float) -> None:
        """A scan with an obstacle ahead; without a distance one that is all unknown."""
        self.seq += 1
        if distance:
            discs = [Disc(distance, 0.05)]
            scan = scan_of(PLATFORM, discs, room=6.0, seq=self.seq, noise=1e-6)
        else:
            scan = empty_scan(PLATFORM, self.seq, self.now, float("nan"))
        self.do(ScanInput(scan))

    def odometry(self) -> None:
        """A reading."""
        for robot in self.robots:
            robot.step(
                OdometryInput(Odometry(self.now, Pose(0.01 * self.seq), Twist(0.1))), self.now
            )

    def tick(self) -> None:
        """A tick."""
        self.do(TICK_INPUT)

    def live(self, seconds: float, *, scans: bool = True, odometry: bool = True) -> None:
        """An ordinary time: ticks, wake-ups, odometry, and scans at 5 Hz."""
        for tick in range(round(seconds / TICK)):
            begin, self.now = self.now, self.now + TICK
            wake_at = self.robots[0].wake_at(begin)
            if wake_at is not None and wake_at < self.now and tick % 8:  # some come late
                end, self.now = self.now, wake_at
                self.tick()
                self.now = end
            if odometry:
                self.odometry()
            if scans and tick % 4 == 0:
                self.scan(2.0)
            self.tick()


def facts(actions: Actions) -> tuple[object, ...]:
    """What the shell is told; of a step, its inputs without arrays."""
    host: object = actions.host
    if isinstance(host, Step):
        given = host.inputs
        seq = None if given.scan is None else given.scan.seq
        host = host.generation, given.now, given.dt, seq, given.is_new_scan, given.odometry
    elif isinstance(host, Load):
        host = host.generation, host.pattern, host.seed, host.is_fresh, host.until
    elif isinstance(host, SetParams):
        host = host.generation, host.request, host.values
    return (
        actions.twist,
        actions.decision,
        actions.requested_scan_seq,
        actions.is_idle,
        actions.is_stopped,
        actions.latches,
        type(actions.trial),
        host,
        actions.messages,
        actions.has_status,
        actions.replies,
    )


def answer_to(command: object, seq: int) -> HostEvent | None:
    """What a host that is well says."""
    if isinstance(command, Load):
        rate = 0.5 if command.pattern == "b" else 10.0
        return Loaded(command.generation, rate, frozenset({"c"}), {"recovery": (True, "d")})
    if isinstance(command, Step):
        return Stepped(command.generation, Outputs(Twist(0.2)), seq)
    if isinstance(command, SetParams):
        return ParamsSet(command.generation, command.request, "", {"recovery": (False, "d")})
    if isinstance(command, StartTrial):
        return TrialDone(command.load.generation, "")
    return None


def host_events(pair: Pair, which: int) -> HostEvent:
    """One of the events that come late, wrong or unexpected."""
    generation = pair.robots[0].status(pair.now).generation
    outputs = Outputs(COMMANDS[which % len(COMMANDS)], {"c": which}, {"n": which})
    events: tuple[HostEvent, ...] = (
        Stepped(generation, outputs, pair.seq),
        Stepped(generation - 1, outputs, pair.seq),
        Stepped(generation, Outputs(Twist(0.1), done="there"), pair.seq),
        Loaded(generation, 8.0, frozenset(), {}),
        LoadRefused(generation, "no"),
        PatternFailed(generation, "boom"),
        HostDied(generation, "killed"),
        ParamsSet(generation, f"q{pair.count}", "", {}),
        TrialDone(1, "broken"),
        TrialDone(2, ""),
    )
    return events[which % len(events)]


def happen(pair: Pair, what: str, which: int) -> None:
    """Let one thing happen."""
    now, robots = pair.now, pair.robots
    hold = (None, Reason.SCAN_CONFLICT)[which % 2]
    if what == "live":
        seconds = (0.05, 0.2, 0.45, 1.3, 3.1)[which % 5]
        pair.live(seconds, scans=which % 3 > 0, odometry=which % 4 > 0)
    elif what == "tick":
        pair.tick()
    elif what == "scan":
        pair.scan((0.0, 0.3, 0.5, 2.0)[which % 4])
    elif what == "odometry":
        pair.odometry()
    elif what == "host":
        pair.host_says(host_events(pair, which))
    elif what == "answering":
        pair.is_answering, pair.takes_params = which % 2 == 0, which % 3 == 0
    elif what == "run":
        pair.is_answering = which % 5 > 0
        for robot in robots:
            robot.step(DriverInput(True, "there"), now)
        pair.ask(ResetRequest, ids=tuple(robots[0].latches))
        pattern, finish = ("a", "b")[which % 2], (None, 0.33, 0.7, 1.2)[which // 2 % 4]
        pair.ask(RunRequest, pattern=pattern, seconds=finish)
    elif what == "stop":
        pair.ask(StopRequest)
    elif what == "estop":
        pair.ask(EstopRequest)
    elif what == "reset":
        pair.ask(ResetRequest, ids=tuple(robots[0].latches))
    elif what == "param":
        pair.ask(ParamRequest, params={"speed": 0.1})
    elif what == "reload":
        pair.ask(ReloadRequest, pattern="a", is_rerun=which % 2 == 0)
    elif what == "driver":
        pair.do(DriverInput(which % 3 > 0, "so", hold=hold))
    elif what == "latches":
        latches = {f"l{which}": Latch(issuer="p", scope="swarm")}
        pair.do(LatchesInput(latches))
    elif what == "duplicate":
        pair.do(DuplicateInput((None, "other")[which % 2]))
    elif what == "network":
        pair.do(NetworkInput("moved"))
    elif what == "roster":
        pair.do(RosterInput("new", is_revoked=which % 8 == 0))
    elif what == "hazards":
        hazards = (Hazard(tuple(HazardKind)[which % 6], "front"),) if which % 4 == 0 else ()
        pair.do(HazardsInput(hazards))
    else:
        for robot in robots:
            robot.step(NeighborsInput((Neighbor("n", 0.0),)), now)
            robot.step(MessageInput("n", "a/c", which), now)
            robot.step(ReadingsInput({"light": float(which)}), now)


WEIGHTS = {
    "live": 6, "tick": 6, "scan": 4, "odometry": 4, "host": 4, "inputs": 1, "run": 4,
    "answering": 2, "stop": 1, "estop": 1, "reset": 1, "param": 2, "reload": 2, "driver": 1,
    "latches": 1, "duplicate": 1, "network": 1, "roster": 1,
    "hazards": 2,
}  # fmt: skip
PAUSES = (0.0, 0.0, 0.01, 0.02, 0.03, TICK, 0.0999995, 0.1, 0.2999995, 0.3, 0.5, 1.0, 1.01, 2.5)


@settings(max_examples=examples(100), suppress_health_check=[HealthCheck.too_slow])
@given(st.randoms(use_true_random=False))
def test_quiet_ticks_change_nothing(chance: Random) -> None:
    pair = Pair()
    pair.live(0.25)
    pair.ask(RunRequest, pattern="a")
    whats = chance.choices(tuple(WEIGHTS), tuple(WEIGHTS.values()), k=40)
    for what in whats:
        pair.now += chance.choice(PAUSES) if chance.random() < 0.5 else 0.0
        happen(pair, what, chance.randrange(60))


@pytest.mark.parametrize(
    "story",
    [
        (("host", 2), ("live", 0), ("live", 4)),  # the pattern is done
        (("run", 1), ("answering", 1), ("stop", 0), ("live", 1), ("live", 4)),  # its host hangs
        (("run", 1), ("answering", 2), ("param", 0), ("live", 14), ("live", 14)),
        (("answering", 1), ("reload", 0), *(("live", 4),) * 4),
        (("answering", 1), ("live", 4)),
        (("host", 6), ("live", 4)),
        (("host", 5), ("answering", 1), ("live", 4), ("live", 4)),
        (("driver", 0), ("live", 4), ("driver", 2), ("live", 4)),
        (("run", 42), ("live", 2), ("live", 3)),
    ],
)
def test_quiet_ticks_miss_no_deadline(story: tuple[tuple[str, int], ...]) -> None:
    pair = Pair()
    pair.live(0.25)
    pair.ask(RunRequest, pattern="a")
    pair.live(0.35)
    for what, which in story:
        happen(pair, what, which)
        pair.live(0.1)


def test_most_ticks_are_quiet_whether_a_pattern_runs_or_not() -> None:
    pair = Pair()
    pair.live(1.0)
    pair.quiet = 0
    pair.live(2.0)
    assert pair.quiet >= 36  # of 40: two statuses
    pair.ask(RunRequest, pattern="a")
    pair.live(1.0)
    pair.quiet = 0
    pair.live(2.0)
    assert pair.quiet >= 26  # of 40: ten steps between scans, two statuses


def test_a_tick_that_is_late_is_not_quiet() -> None:
    pair = Pair()
    pair.live(1.0)
    pair.now += 1.5
    pair.tick()
    assert pair.robots[0].epoch.revision == 1


def test_quiet_tick_gives_the_command_alone() -> None:
    harness: RobotHarness = started()
    harness.advance(1.0)
    for _ in range(20):
        harness.now += 0.01
        actions = acted(harness.robot, TICK_INPUT, harness.now)
        if actions.is_quiet:
            break
    assert actions.is_quiet
    assert actions.twist == Twist(0.2)
    assert (actions.host, actions.trial, actions.latches) == (None,) * 3
    assert not actions.has_status
    assert (dict(actions.messages), actions.replies) == ({}, ())


def known_of(robot: Robot) -> tuple[object, ...]:
    """What operators and peers act on."""
    return robot.state, robot.reason, robot.epoch, dict(robot.latches), robot.generations


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.too_slow])
@given(st.randoms(use_true_random=False))
def test_time_changes_nothing_of_a_robot_at_rest(chance: Random) -> None:
    pair = Pair()
    robot = pair.robots[0]
    pair.live(0.25)
    assert robot.is_at_rest
    pair.ask(RunRequest, pattern="a")
    assert not robot.is_at_rest
    for what in chance.choices(tuple(WEIGHTS), tuple(WEIGHTS.values()), k=30):
        happen(pair, what, chance.randrange(60))
        if not robot.is_at_rest:
            continue
        before = known_of(robot)
        for _ in range(chance.randrange(1, 70)):
            pair.now += 2.0 * TICK
            pair.odometry()
            pair.do(TICK_INPUT)
            assert robot.decision.safe.is_zero
        assert robot.is_at_rest
        assert known_of(robot) == before


def test_a_robot_whose_base_another_node_drives_is_not_at_rest() -> None:
    pair = Pair()
    pair.live(0.25)
    pair.do(DriverInput(False, "someone else drives", gets_zero=True))
    pair.ask(StopRequest)
    assert not pair.robots[0].is_at_rest
    pair.do(DriverInput(True, "connected"))
    assert pair.robots[0].is_at_rest


@pytest.mark.parametrize("late", [0.99, 1.01])
def test_a_stall_of_a_robot_at_rest_is_found_as_ever(late: float) -> None:
    pair = Pair()
    pair.live(1.0)
    assert pair.robots[0].is_at_rest
    pair.now += late
    pair.tick()
    assert pair.robots[0].epoch.revision == (late > 1.0)
