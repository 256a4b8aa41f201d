"""Events of a scenario on a fleet: in order, when due, with what went wrong."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import SimpleNamespace
from typing import Any, cast

import pytest

from swarmd.core.errors import SwarmError
from swarmd.core.messages import Code, Epoch, Reply
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.sim.live.demo_run import LiveTimeline
from swarmd.sim.live.fleet import Fleet
from swarmd.sim.live.link import WorldView
from swarmd.sim.scenarios.scenario import ScheduledEvent
from swarmd.sim.world.faults import FrozenProcess, NoisyScan
from tests.support.statuses import make_member

ROBOTS = ("a", "b", "c")


class Stage:
    """A fleet, its operator and its world in one, which list what is done to them."""

    def __init__(self, *present: str) -> None:
        self.spec = SimpleNamespace(robots=dict.fromkeys(ROBOTS), folder="logs", all_hear_all=False)
        self.robots = present
        self.done: list[tuple[Any, ...]] = []
        self.code = Code.APPLIED

    def timeline(self, *events: ScheduledEvent) -> LiveTimeline:
        return LiveTimeline(events, cast(Fleet, self), cast(Operator, self), cast(WorldView, self))

    def check(self) -> None:
        pass

    def start_daemon(self, robot: str) -> None:
        self.robots += (robot,)
        self.done.append(("start", robot))

    def end_daemon(self, robot: str, *, in_order: bool) -> None:
        self.robots = tuple(one for one in self.robots if one != robot)
        self.done.append(("end", robot, in_order))

    def members(self) -> MembersView:
        return MembersView({robot: make_member(robot) for robot in self.robots})

    def request(self, kind: type, targets: Mapping[str, Epoch | None], **fields: Any) -> Outcome:
        self.done.append((kind.__name__, tuple(targets), fields))
        return self._outcome(targets)

    def send_stop(self, verb: str, *, select: Any = None, names: Collection[str] = ()) -> Outcome:
        self.done.append((verb, None if select is None else tuple(names)))
        return self._outcome(names or self.robots)

    def place(self, box: str, pose: tuple[float, ...]) -> None:
        raise SwarmError(f"{box} would overlap a")

    def take_out(self, robot: str) -> None:
        self.done.append(("out", robot))

    def change_fault(
        self, fault: Mapping[str, Any], robots: Collection[str], *, is_on: bool
    ) -> None:
        self.done.append((fault, tuple(robots), is_on))

    def halt_daemon(self, robot: str, *, is_on: bool) -> None:
        self.done.append(("halt", robot, is_on))

    def _outcome(self, robots: Collection[str]) -> Outcome:
        texts = {robot: Reply(id="1", robot=robot, code=self.code, text="no") for robot in robots}
        return Outcome(texts, missing=())


def event(at: float, action: Any, *robots: str, **values: Any) -> ScheduledEvent:
    return ScheduledEvent(at=at, action=action, robots=robots, **values)


def test_events_are_carried_out_when_due_and_in_order() -> None:
    stage = Stage("a", "b")
    timeline = stage.timeline(event(1.0, "join", "c"), event(2.0, "kill", "a"))
    timeline.apply(0.9)
    assert stage.done == []
    timeline.apply(5.0)
    assert stage.done == [("start", "c"), ("end", "a", False)]
    assert [(one.at, one.done_at) for one in timeline.done] == [(1.0, 5.0), (2.0, 5.0)]
    timeline.apply(6.0)
    assert len(stage.done) == 2


def test_requests_go_to_the_robots_that_have_a_daemon() -> None:
    stage = Stage("a", "b")
    run = event(1.0, "run", *ROBOTS, pattern="drive", parameters={"speed": 0.1}, seconds=3.0)
    stage.timeline(run, event(2.0, "param", "b", "c", parameters={"speed": 0.2})).apply(2.0)
    (kind, targets, fields), (_, second, values) = stage.done
    assert (kind, targets, second) == ("RunRequest", ("a", "b"), ("b",))
    assert (fields["pattern"], fields["seconds"]) == ("drive", 3.0)
    assert values == {"params": {"speed": 0.2}}


@pytest.mark.parametrize(
    ("present", "robots", "names"),
    [(ROBOTS, ROBOTS, None), (ROBOTS, ("a",), ("a",)), (("a", "b"), ROBOTS, ("a", "b"))],
)
def test_a_stop_waits_for_no_daemon_that_was_ended(
    present: tuple[str, ...], robots: tuple[str, ...], names: tuple[str, ...] | None
) -> None:
    stage = Stage(*present)
    stage.timeline(event(1.0, "estop", *robots)).apply(1.0)
    assert stage.done == [("estop", names)]


def test_faults_are_of_the_world_and_those_of_processes_of_the_fleet() -> None:
    stage = Stage(*ROBOTS)
    noise, frozen = NoisyScan(sd=0.3), FrozenProcess()
    stage.timeline(
        event(1.0, "fault", "a", "b", fault=noise),
        event(2.0, "mend", "a", "b", fault=noise),
        event(3.0, "fault", "c", fault=frozen),
        event(4.0, "mend", "c", fault=frozen),
    ).apply(4.0)
    plain = {"scan": "noise", "sd": 0.3}
    assert stage.done == [
        *((plain, ("a", "b"), is_on) for is_on in (True, False)),
        *(("halt", "c", is_on) for is_on in (True, False)),
    ]


def test_a_removed_robot_leaves_the_arena() -> None:
    stage = Stage(*ROBOTS)
    stage.timeline(event(1.0, "remove", "b")).apply(1.0)
    assert stage.done == [("end", "b", False), ("out", "b")]


def test_what_fails_is_a_problem_and_the_next_event_follows() -> None:
    stage = Stage(*ROBOTS)
    stage.code = Code.REFUSED
    place = event(1.0, "place", box="crate", pose=(0.0, 0.0, 0.0))
    timeline = stage.timeline(place, event(2.0, "stop", "a"), event(3.0, "leave", "a"))
    timeline.apply(3.0)
    problems = [one.problem for one in timeline.done]
    assert "crate" in problems[0]
    assert "a" in problems[1]
    assert problems[2] == ""
