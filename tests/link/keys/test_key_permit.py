"""What a permit permits, by the table of docs/permits.md."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from swarmd.core.bounds import ParamValues
from swarmd.core.errors import ConfigError
from swarmd.core.goal import Goal
from swarmd.core.messages import Epoch
from swarmd.core.verbs import (
    VERBS,
    AnyRequest,
    DriveRequest,
    EstopRequest,
    GoalRequest,
    ParamRequest,
    ResetRequest,
    RunRequest,
    StopRequest,
)
from swarmd.link.keys.key_permit import (
    Denial,
    PresentRun,
    check_permit,
    judge,
    permit_text,
    stoppable,
)
from swarmd.link.keys.roster import KeyPermit

NOW = 1_800_000_000
EPOCH = Epoch("0123456789ab", 1)
TARGETS: dict[str, Epoch | None] = {"tb3-01": EPOCH, "tb3-07": EPOCH}
ROBOTS = tuple(f"tb3-0{number}" for number in range(1, 8))
PUPILS = KeyPermit(
    role="pupils",
    key=bytes(64),
    may=("stop", "run attraction", "param attraction.*"),
    robots="tb3-0[1-3]",
    longest=60.0,
    speed=0.15,
    until=NOW + 600,
)


def permit(*may: str, **fields: Any) -> KeyPermit:
    return msgspec.structs.replace(
        KeyPermit(role="any", key=bytes(64), may=may, until=NOW + 10**6), **fields
    )


def run(pattern: str = "attraction", **fields: Any) -> RunRequest:
    return RunRequest(id="r1", operator="anna", targets=TARGETS, pattern=pattern, **fields)


def param(*names: str) -> ParamRequest:
    params: ParamValues = dict.fromkeys(names, 0.1)
    return ParamRequest(id="p1", operator="anna", targets=TARGETS, params=params)


def stop(**fields: Any) -> StopRequest:
    return StopRequest(id="s1", operator="anna", **fields)


def estop(**fields: Any) -> EstopRequest:
    return EstopRequest(id="e1", operator="anna", **fields)


def is_permitted(
    of: KeyPermit,
    request: AnyRequest,
    robot: str = "tb3-01",
    wall: float = NOW,
    running: PresentRun | None = None,
) -> bool:
    judged = judge(of, request, robot, wall=wall, running=running)
    return not isinstance(judged, Denial)


@pytest.mark.parametrize(
    ("may", "pattern", "wanted"),
    [
        ("run attraction", "attraction", True),
        ("run attraction", "attraction2", False),
        ("run attraction", "flocking", False),
        ("run attr*", "attraction", True),
        ("run attr*", "xattraction", False),
        ("run a?traction", "attraction", True),
        ("run", "flocking", True),
        ("run [a-z]*", "attraction", False),  # a glob has no brackets
        ("running attraction", "attraction", False),
        ("Run attraction", "attraction", False),
        ("param attraction.*", "attraction", False),
        ("stop", "attraction", False),
    ],
)
def test_a_run_needs_a_line_for_its_pattern(may: str, pattern: str, wanted: bool) -> None:
    assert is_permitted(permit(may), run(pattern)) is wanted


@pytest.mark.parametrize(
    ("may", "name", "wanted"),
    [
        ("param attraction.*", "gain", True),
        ("param attraction.gain", "gain", True),
        ("param attraction.gain", "range", False),
        ("param attraction.ga*", "gain", True),
        ("param flocking.*", "gain", False),
        ("param", "gain", True),
        ("run attraction", "gain", False),
        ("param attraction", "gain", False),
    ],
)
def test_parameters_need_a_line_both_in_a_run_and_while_it_runs(
    may: str, name: str, wanted: bool
) -> None:
    running = PresentRun("attraction")
    assert is_permitted(permit(may), param(name), running=running) is wanted
    assert is_permitted(permit(may, "run"), run(params={name: 1.0})) is wanted


def test_each_of_several_parameters_needs_a_line() -> None:
    of = permit("param attraction.gain")
    running = PresentRun("attraction")
    assert not is_permitted(of, param("gain", "range"), running=running)


def test_parameters_are_those_of_the_pattern_that_runs_there() -> None:
    of = permit("param attraction.*")
    assert not is_permitted(of, param("gain"), running=PresentRun("flocking"))


@pytest.mark.parametrize(
    ("robot", "wanted"), [("tb3-01", True), ("tb3-03", True), ("tb3-04", False), ("tb3-07", False)]
)
def test_robots_bound_runs_and_parameters(robot: str, wanted: bool) -> None:
    running = PresentRun("attraction", 0.15)
    assert is_permitted(PUPILS, run(), robot) is wanted
    assert is_permitted(PUPILS, param("gain"), robot, running=running) is wanted


@pytest.mark.parametrize("request_", [stop(), stop(targets={"tb3-07": None})])
def test_nothing_narrows_the_stop_of_a_valid_permit(request_: StopRequest) -> None:
    judged = judge(PUPILS, request_, "tb3-07", wall=NOW)
    assert judged == request_


def test_a_stop_of_named_robots_stops_no_other_and_sets_nothing_for_others() -> None:
    of = permit("stop tb3-0[1-3]", "estop tb3-01", "run")
    assert not is_permitted(of, stop(), "tb3-07")
    assert not is_permitted(of, stop(targets={"tb3-07": None}), "tb3-07")
    assert not is_permitted(of, estop(), "tb3-02")
    judged = judge(of, stop(), "tb3-02", wall=NOW)
    assert isinstance(judged, StopRequest)
    assert judged.targets == {"tb3-02": None}
    for asked in (estop(), estop(targets={"tb3-01": None}, scope="swarm")):
        latch = judge(of, asked, "tb3-01", wall=NOW)
        assert isinstance(latch, EstopRequest)
        assert (latch.targets, latch.scope) == ({"tb3-01": None}, "robots")
    assert stoppable(of, "stop", ("tb3-01", "tb3-07", "fox-1")) == ("tb3-01",)
    assert stoppable(permit("run"), "stop", ("tb3-01",)) == ()
    assert stoppable(PUPILS, "stop", ("tb3-01", "tb3-07")) == ("tb3-01", "tb3-07")


@pytest.mark.parametrize("wall", [NOW + 600, NOW + 10**6, 0.0, 1_600_000_000.0])
def test_no_permit_counts_after_its_end_or_where_no_clock_is_set(wall: float) -> None:
    assert not is_permitted(PUPILS, stop(), wall=wall)
    assert not is_permitted(PUPILS, run(), wall=wall)
    assert is_permitted(PUPILS, stop(), wall=NOW + 599)


@pytest.mark.parametrize(("asked", "wanted"), [(None, 60.0), (30.0, 30.0), (60.0, 60.0)])
def test_a_run_ends_within_its_bound(asked: float | None, wanted: float) -> None:
    judged = judge(PUPILS, run(seconds=asked), "tb3-01", wall=NOW)
    assert isinstance(judged, RunRequest)
    assert judged.seconds == wanted


def test_a_run_is_refused_beyond_its_bound_and_ends_with_its_permit() -> None:
    assert not is_permitted(PUPILS, run(seconds=61.0))
    judged = judge(PUPILS, run(), "tb3-01", wall=NOW + 590)
    assert isinstance(judged, RunRequest)
    assert judged.seconds == 10.0
    later = judge(PUPILS, run(at={"tb3-01": 5.0}), "tb3-01", wall=NOW + 530)
    assert isinstance(later, RunRequest)
    assert later.seconds == 10.0  # it may begin 60 s later
    assert not is_permitted(PUPILS, run(at={"tb3-01": 5.0}), wall=NOW + 541)


def test_a_run_has_the_bound_of_speed_and_parameters_keep_it() -> None:
    for asked, wanted in ((None, 0.15), (0.1, 0.1), (0.3, 0.15)):
        judged = judge(PUPILS, run(speed=asked), "tb3-01", wall=NOW)
        assert isinstance(judged, RunRequest)
        assert judged.speed == wanted
    for speed, wanted_ in ((None, False), (0.3, False), (0.15, True), (0.1, True)):
        running = PresentRun("attraction", speed)
        assert is_permitted(PUPILS, param("gain"), running=running) is wanted_


def test_a_run_in_a_goal_is_refused() -> None:
    """A goal spreads to other robots, also one that an operator has signed."""
    goal = Goal(generation=7, issuer="teacher", id="g", pattern="attraction", signature=b"s" * 64)
    assert not is_permitted(PUPILS, run(goal=goal))


def test_every_other_verb_is_refused_to_the_widest_permit() -> None:
    widest = permit("stop", "estop", "run", "param", "drive", *VERBS)
    others = {row.name for row in VERBS.values() if row.is_request}
    others -= {"stop", "estop", "run", "param", "drive"}
    assert others == {
        *("resume", "goal", "label", "reset", "reload", "push", "forget", "record", "mark"),
        "roster",
    }
    goal = Goal(generation=1, issuer="anna", id="g")
    refused: tuple[AnyRequest, ...] = (
        ResetRequest(id="r", operator="anna", targets=TARGETS),
        GoalRequest(id="g", operator="anna", targets=TARGETS, goal=goal),
    )
    for request in refused:
        assert not is_permitted(widest, request)


def test_an_answer_says_what_the_key_may() -> None:
    denial = judge(PUPILS, run("flocking"), "tb3-01", wall=NOW)
    assert isinstance(denial, Denial)
    assert denial.text.startswith("anna may not run flocking")
    assert permit_text(PUPILS) in denial.text
    for part in (*PUPILS.may, "tb3-0[1-3]", "60 s", "0.15 m/s", "2027-01-15 08:10 UTC"):
        assert part in permit_text(PUPILS)


@pytest.mark.parametrize(
    ("may", "robots"),
    [
        (("fly",), ""),
        (("reset",), ""),
        (("run a,b", "stop"), ""),
        (("run [ab]", "stop"), ""),
        (("run attraction fast", "stop"), ""),
        (("param gain", "stop"), ""),
        (("stop tb3-[",), ""),
        (("stop",), "TB3"),
        (("stop",), "tb4-*"),  # no such robot
        (("stop tb4-01",), ""),
        (("run attraction",), ""),  # whoever may run must be able to stop
    ],
)
def test_a_permit_that_cannot_be_meant_is_not_issued(may: tuple[str, ...], robots: str) -> None:
    with pytest.raises(ConfigError):
        check_permit(permit(*may, robots=robots), ROBOTS)
    check_permit(PUPILS, ROBOTS)


def drive(**fields: Any) -> DriveRequest:
    return DriveRequest(id="d1", operator="anna", targets=TARGETS, **fields)


def test_a_hand_is_permitted_on_its_robots_and_bounded_by_for_speed_and_the_end() -> None:
    of = permit("stop", "drive", robots="tb3-0[1-3]", longest=60.0, speed=0.15)
    assert judge(of, drive(), "tb3-01", wall=NOW) == drive(seconds=60.0, speed=0.15)
    assert judge(of, drive(speed=0.1), "tb3-01", wall=NOW) == drive(seconds=60.0, speed=0.1)
    late = judge(of, drive(), "tb3-01", wall=of.until - 5)
    assert late == drive(seconds=5.0, speed=0.15)
    for robot, wall in (("tb3-07", NOW), ("tb3-01", of.until), ("tb3-01", 0.0)):
        assert isinstance(judge(of, drive(), robot, wall=wall), Denial)


@pytest.mark.parametrize("may", [("stop",), ("stop", "run"), ("stop", "drive tb3-01"), ("run *",)])
def test_no_other_line_permits_a_hand(may: tuple[str, ...]) -> None:
    assert isinstance(judge(permit(*may), drive(), "tb3-01", wall=NOW), Denial)
    assert isinstance(
        judge(permit(*may), drive(is_release=True, hand="d0"), "tb3-01", wall=NOW), Denial
    )


def test_whoever_may_drive_must_be_able_to_stop_and_robots_names_where() -> None:
    check_permit(permit("stop", "drive"), ROBOTS)
    for may in (("drive",), ("stop", "drive tb3-01")):
        with pytest.raises(ConfigError):
            check_permit(permit(*may), ROBOTS)
