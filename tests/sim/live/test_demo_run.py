"""The course of a demo: states of the world, and robots that start late or not at all."""

from __future__ import annotations

import errno
import signal
import subprocess
import sys
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, NetworkError, SwarmError
from swarmd.core.messages import Code, Epoch, Reply, State
from swarmd.core.verbs import RunRequest
from swarmd.operator.session.members_view import MembersView, SeenMember
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.view.scene import Scene
from swarmd.sim.live.demo_run import DemoRun, WorldWatcher
from swarmd.sim.live.fleet import Fleet
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.starting import know_each_other, start_pattern
from swarmd.sim.live.state import WorldState
from swarmd.sim.live.summary import DemoSummary
from swarmd.sim.scenarios.scenario import ScheduledEvent
from swarmd.sim.trace import Trace, load_trace
from tests.support.statuses import make_member
from tests.support.traces import trace_of, world_state

ROBOTS = ("a", "b", "c")
RUN = ScheduledEvent(at=0.0, action="run", robots=ROBOTS, pattern="drive")


class FakeWorld:
    """A world whose states a test sends."""

    def __init__(self) -> None:
        self.send: Callable[[WorldState], None] = lambda state: None

    def watch(self, handler: Callable[[WorldState], None]) -> None:
        self.send = handler


class FakeOperator:
    """Gives prepared answers: for each round of `run` a code by robot; None: no answer.

    A robot that applied is seen running from then on, as is each in `running`.
    """

    def __init__(self, *rounds: Mapping[str, Code | None]) -> None:
        self._rounds = iter(rounds)
        self.asked: list[tuple[str, ...]] = []
        self.running: set[str] = set()

    def request(
        self, kind: type[RunRequest], targets: Mapping[str, Epoch | None], **fields: Any
    ) -> Outcome:
        self.asked.append(tuple(targets))
        codes = next(self._rounds)
        replies = {
            robot: Reply(id="1", robot=robot, code=code, text=f"{robot} says {code}")
            for robot in targets
            if (code := codes[robot]) is not None
        }
        self.running |= {robot for robot, code in codes.items() if code is Code.APPLIED}
        return Outcome(replies, missing=tuple(sorted(set(targets) - replies.keys())))

    def members(self) -> MembersView:
        return MembersView({robot: self._member(robot) for robot in ROBOTS})

    def _member(self, robot: str) -> SeenMember:
        state = State.RUNNING if robot in self.running else State.IDLE
        return make_member(robot, state=state)


@pytest.mark.parametrize(
    ("near", "all_hear_all", "known"),
    [
        ({"a": ("b", "c"), "b": ("a", "c"), "c": ("a", "b")}, True, True),
        ({"a": ("b",), "b": ("a", "c"), "c": ("a", "b")}, False, False),
        ({"a": ("b",), "b": ("a", "c"), "c": ("b",)}, False, True),
        ({"a": ("b",), "b": ("a", "c"), "c": ("b",)}, True, False),
        ({"a": (), "b": ("c",), "c": ("b", "other")}, False, True),
    ],
)
def test_robots_know_each_other_if_hearing_is_mutual(
    near: Mapping[str, tuple[str, ...]], all_hear_all: bool, known: bool
) -> None:
    view = MembersView({robot: make_member(robot, neighbors=near[robot]) for robot in ROBOTS})
    assert know_each_other(view, ROBOTS, all_hear_all) is known


def start(operator: FakeOperator) -> dict[str, str]:
    return start_pattern(cast(Operator, operator), operator.members(), RUN)


def state(time: float, *xs: float) -> WorldState:
    return world_state([(x, 0.0, 0.0) for x in xs], time=time)


@pytest.fixture
def world() -> FakeWorld:
    return FakeWorld()


@pytest.fixture
def watcher(world: FakeWorld) -> WorldWatcher:
    return WorldWatcher(cast(WorldView, world), timeout=0.0)


def test_the_newest_state_is_given_or_an_error(world: FakeWorld, watcher: WorldWatcher) -> None:
    world.send(state(1.0, 0.0))
    world.send(state(2.0, 0.0))
    assert watcher.wait(since=1.5).time == 2.0
    with pytest.raises(NetworkError):
        watcher.wait(since=2.0)


LOST: Mapping[str, Code | None] = {"b": Code.FAILED, "c": None}


@pytest.mark.parametrize(
    ("rounds", "running", "missing", "asked"),
    [
        ([dict.fromkeys(ROBOTS, Code.APPLIED)], "", {}, [ROBOTS]),
        # Those that fail or do not answer are asked again,
        (
            [{"a": Code.APPLIED, **LOST}, {"b": Code.APPLIED, "c": None}, {"c": Code.APPLIED}],
            "",
            {},
            [ROBOTS, ("b", "c"), ("c",)],
        ),
        # but a robot that runs is not, although its answer is missing,
        (
            [{"a": Code.APPLIED, "b": Code.APPLIED, "c": None}, {}],
            "c",
            {},
            [ROBOTS, ()],
        ),
        # and the demo goes on without those that do not start.
        (
            [{"a": Code.APPLIED, **LOST}, LOST, LOST],
            "",
            {"b": "b says failed", "c": "no answer"},
            [ROBOTS, ("b", "c"), ("b", "c")],
        ),
    ],
)
def test_robots_that_did_not_start_are_asked_again(
    rounds: list[Mapping[str, Code | None]], running: str, missing: Mapping[str, str], asked: object
) -> None:
    operator = FakeOperator(*rounds)
    operator.running = set(running)
    assert start(operator) == missing
    assert operator.asked == asked


def test_if_none_starts_the_error_has_each_failure_in_its_own_words() -> None:
    answers = {"a": Code.FAILED, "b": Code.FAILED, "c": None}
    with pytest.raises(SwarmError) as caught:
        start(FakeOperator(answers, answers, answers))
    for text in ("a: a says failed", "b: b says failed", "c: no answer"):
        assert text in str(caught.value)


def test_a_request_that_all_refuse_is_not_repeated() -> None:
    operator = FakeOperator(dict.fromkeys(ROBOTS, Code.REFUSED))
    with pytest.raises(ConfigError, match="a: a says refused"):
        start(operator)
    assert len(operator.asked) == 1


@pytest.mark.integration
def test_a_demo_starts_without_the_libraries_that_only_its_world_or_its_view_needs() -> None:
    code = "import sys, swarmd.sim.live.demo_run; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"mujoco", "scipy", "matplotlib", "rich"} & set(done.stdout.split())


class ShortDemo:
    """Fleet, operator and world of a demo of two robots, which `end` ends early at 0.1 s."""

    robots = ("r0", "r1")

    def __init__(self, trace: Path, end: Callable[[], object]) -> None:
        self.spec = SimpleNamespace(
            **{"robots": dict.fromkeys(self.robots, "burger"), "folder": trace.parent},
            **{"swarm": "s", "all_hear_all": False, "arena": "6x6", "layout": "row", "seed": 0},
            live=None,
        )
        self.trace, self.end = trace, end
        self.is_world_dead = False
        self.stopped: list[str] = []
        self._take: Callable[[WorldState], None] = lambda state: None

    def perform(self) -> DemoSummary:
        run = ScheduledEvent(at=0.0, action="run", robots=self.robots, pattern="drive")
        fleet, operator, world = cast(Fleet, self), cast(Operator, self), cast(WorldView, self)
        return DemoRun((run,), 60.0, fleet, operator, world, self.show).perform(self.trace, 0.0)

    def show(self, scene: Scene) -> None:
        self.end()
        self._take(state(0.2, 0.0, 1.0))

    def check(self, *names: str) -> None:
        if self.is_world_dead:
            raise SwarmError("the world was killed")

    def members(self, timeout: float = 0.0) -> MembersView:
        return MembersView({robot: make_member(robot) for robot in self.robots})

    def request(self, kind: type, targets: Collection[str], **fields: Any) -> Outcome:
        applied = {r: Reply(id="1", robot=r, code=Code.APPLIED) for r in targets}
        return Outcome(applied, missing=())

    def send_stop(self, verb: str) -> Outcome:
        self.stopped.append(verb)
        return Outcome({}, missing=())

    def watch(self, handler: Callable[[WorldState], None]) -> None:
        self._take = handler

    def ask(self, action: str) -> Any:
        if action == "start":
            self._take(state(0.1, 0.0, 1.0))
            return SimpleNamespace(state=state(0.0, 0.0, 1.0))
        trace_of(np.arange(12.0).reshape(2, 2, 3)).save(self.trace)
        return SimpleNamespace(state=state(0.1, 0.0, 1.0))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_demo_with_a_stop_and_a_summary(
    tmp_path: Path, number: signal.Signals
) -> None:
    before = signal.getsignal(number)
    demo = ShortDemo(tmp_path / "trace.npz", lambda: signal.raise_signal(number))
    summary = demo.perform()
    assert summary.signal == number
    assert summary.problems[0] == f"{number.name} ended the run early"
    assert summary.seconds == 0.1
    assert demo.stopped == ["stop"]
    assert signal.getsignal(number) is before
    assert load_trace(demo.trace).meta["pattern"] == "drive"


def test_a_full_disk_costs_no_summary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(trace: Trace, path: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    def load(path: Path) -> Trace:
        trace = load_trace(path)
        monkeypatch.setattr(Trace, "save", fail)  # the world has written its own
        return trace

    monkeypatch.setattr("swarmd.sim.live.demo_run.load_trace", load)
    demo = ShortDemo(tmp_path / "trace.npz", lambda: signal.raise_signal(signal.SIGINT))
    summary = demo.perform()
    assert summary.seconds == 0.1
    assert any("No space left on device" in problem for problem in summary.problems)


def test_a_fault_of_a_robot_costs_no_summary_and_that_of_the_world_is_the_error(
    tmp_path: Path,
) -> None:
    def fail() -> None:
        raise SwarmError("r1 was killed")

    demo = ShortDemo(tmp_path / "trace.npz", fail)
    summary = demo.perform()
    assert (summary.signal, summary.problems[0]) == (0, "r1 was killed")
    assert demo.stopped == ["stop"]

    def end_world() -> None:
        demo.is_world_dead = True
        raise SwarmError("the world is silent")

    demo.end = end_world
    with pytest.raises(SwarmError, match="the world was killed"):
        demo.perform()
