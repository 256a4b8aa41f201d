"""Incidents in histories: stories that once broke a rule, and faults that break one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from swarmd.core import incident as core_incident
from swarmd.core.events import DriverInput, Input, NoteInput
from swarmd.core.incident import IncidentKind
from swarmd.core.verbs import KeptIncident
from swarmd.daemon import incident_budget, incidents
from swarmd.daemon.incidents import IncidentService
from swarmd.robot.actions import Actions
from swarmd.robot.robot import Robot
from tests.histories import invariants, swarm
from tests.histories.history import OPERATORS, History, Steps, fault_of, replay, step
from tests.histories.invariants import INCIDENT_FILES

MARKED = (step(0.0, "run", by="anna"), step(2.0, "incident", by="bob"))
SPLIT = (
    step(0.0, "split", groups=(("r1", "anna"), ("r2", "r3", "bob"))),
    step(0.1, "incident", by="bob", targets=("r2",)),
    step(20.0, "heal"),
)
KILLED = (
    step(0.0, "run", by="anna"),
    step(2.0, "kill", robot="r1"),
    step(6.0, "start", robot="r1"),
)
MANY = tuple(
    step(11.0, "incident", by="anna", targets=(f"r{1 + number % 5}",)) for number in range(30)
)
RESTARTED = (
    step(0.0, "incident", by="anna", targets=("r1",)),
    step(13.0, "incident", by="anna", targets=("r1",)),
    step(1.0, "start", robot="r1"),
    step(0.5, "incident", by="anna", targets=("r1",)),
)


def kept(steps: Steps, count: int = 3) -> dict[str, dict[str, tuple[str, str]]]:
    """As `files_of` at the end of a history."""
    return files_of(replay(count, steps))


def files_of(history: History) -> dict[str, dict[str, tuple[str, str]]]:
    """By robot: the ids of its files, with the kind of the incident and the robot that had it."""
    return {
        one.name: {
            id: (head.incident.kind, head.incident.robot)
            for id, head in one.black_box.heads().items()
        }
        for one in history.swarm.robots.values()
    }


@pytest.mark.parametrize("steps", [MARKED, SPLIT], ids=["marked", "split"])
def test_each_robot_keeps_what_was_marked_under_one_id(steps: Steps) -> None:
    files = kept(steps)
    assert files["r1"].keys() == files["r2"].keys() == files["r3"].keys()
    assert [kind for kind, _ in files["r1"].values()].count(IncidentKind.MARK) == 1


def test_a_robot_whose_daemon_was_killed_keeps_that_as_its_peers_do() -> None:
    files = kept(KILLED)
    assert files["r1"] == files["r2"] == files["r3"]
    assert [*files["r1"].values()] == [(IncidentKind.SILENT, "r1")]


def test_a_daemon_that_is_killed_as_its_run_begins_gives_the_id_of_its_peers() -> None:
    run, _, start = KILLED
    files = kept((run, step(0.4, "kill", robot="r1"), start))
    assert [*files["r1"].values()] == [(IncidentKind.SILENT, "r1")]
    assert files["r1"] == files["r2"] == files["r3"]


def test_a_death_is_kept_also_if_the_robot_was_unheard_before_in_the_same_run() -> None:
    history = History(3)
    split = step(2.0, "split", groups=(("r1",), ("r2", "r3", "anna", "bob")))
    heal, kill = step(4.0, "heal"), step(20.0, "kill", robot="r1")
    for one in (KILLED[0], split, heal, kill, step(20.0, "heal")):
        history.carry_out(one)
    before = files_of(history)
    assert [*before["r2"].values()].count((IncidentKind.SILENT, "r1")) == 2
    history.end()
    assert before["r2"] == before["r3"] == files_of(history)["r1"]


def test_a_stall_is_kept_also_if_the_robot_was_unheard_before_in_the_same_run() -> None:
    split = step(2.0, "split", groups=(("r1",), ("r2", "r3", "anna", "bob")))
    freeze = step(20.0, "freeze", robot="r1", seconds=1.5)
    files = kept((KILLED[0], split, step(4.0, "heal"), freeze, step(5.0, "heal")))
    assert (IncidentKind.STALL, "r1") in files["r1"].values()
    assert files["r1"] == files["r2"] == files["r3"]


def test_a_long_stall_has_one_id_on_all_robots() -> None:
    files = kept((KILLED[0], step(2.0, "freeze", robot="r1", seconds=25.0), step(30.0, "heal")))
    assert files["r1"].keys() == files["r2"].keys() == files["r3"].keys()
    assert len(files["r1"]) == 1


def test_a_death_is_kept_also_if_the_clock_is_set_by_days_before_the_start() -> None:
    run, kill, start = KILLED
    files = kept((run, kill, step(0.1, "wall", robot="r1", shift=1e6), start))
    assert [*files["r1"].values()] == [(IncidentKind.SILENT, "r1")]


def test_incidents_that_are_heard_at_once_leave_no_more_files_than_may_be(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(incident_budget, "MAX_KEPT", 3)
    monkeypatch.setattr(invariants, "INCIDENT_FILES", 3)
    names = ("r1", "r2", "r3", "r4")
    history = History(5)
    history.carry_out(step(0.0, "split", groups=(("r5",), (*names, *OPERATORS))))
    for name in names:
        history.carry_out(step(1.0, "estop", by="anna", targets=(name,)))
    history.carry_out(step(25.0, "heal"))
    history.carry_out(step(5.0, "heal"))
    assert history.swarm.robots["r5"].black_box.count() == 3


def test_restarts_begin_no_more_incidents_than_the_limits_allow() -> None:
    # The third mark follows the second one by 1.5 s, with a restart between them.
    marks = [kind for kind, _ in kept(RESTARTED, 2)["r1"].values() if kind == IncidentKind.MARK]
    assert len(marks) == 2
    deaths = kept(tuple(step(12.0, "start", robot="r1") for _ in range(9)), 2)["r1"]
    assert len(deaths) == 6  # an hour


WOLF = (
    step(0.0, "incident", by="anna"),
    step(11.0, "incident", by="bob"),
    *(step(11.0, "wolf", robot="r3", kind="mark") for _ in range(3)),
    *(step(11.0, "wolf", robot="r3", kind=kind) for kind in ("hazard", "estop", "fault", "silent")),
    step(30.0, "heal"),
)


def few_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot keeps four files, two of them marks."""
    monkeypatch.setattr(incident_budget, "MAX_KEPT", 4)
    monkeypatch.setattr(invariants, "INCIDENT_FILES", 4)


def test_a_robot_that_cries_wolf_removes_no_mark_of_an_operator(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    few_files(monkeypatch)
    history = replay(3, WOLF)
    for name in ("r1", "r2"):
        heads = history.swarm.robots[name].black_box.heads().values()
        assert len(heads) == 4, "the wolf has taken what is free"
        marks = {one.operator for one in heads if one.operator}
        assert marks == {"anna", "bob"}


def test_lies_in_the_name_of_a_robot_displace_none_of_its_true_incidents(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    few_files(monkeypatch)
    lies = tuple(step(11.0, "wolf", robot="r3", kind="fault", teller="r2") for _ in range(5))
    files = kept((step(0.0, "estop", by="anna", targets=("r2",)), *lies, step(30.0, "heal")))
    assert (IncidentKind.ESTOP, "r2") in files["r1"].values()


def oldest(kept: Sequence[KeptIncident], new: KeptIncident) -> list[str]:
    """The file that gives way is the oldest, whoever told it."""
    return [one.incident.id for one in kept[: max(len(kept) - 3, 0)]]


def test_the_oldest_file_that_gives_way_breaks_a_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    few_files(monkeypatch)
    monkeypatch.setattr(incidents, "to_remove", oldest)
    fault = fault_of(3, WOLF)
    assert fault is not None
    assert fault.rule == "fair"


def test_a_mark_of_all_robots_is_noted_by_each_as_its_own() -> None:
    """Some have heard of it from a peer before the request of the operator came."""
    late = step(0.0, "cut", senders=("anna",), receivers=("r3", "r4", "r5"))
    files = kept((late, step(0.1, "incident", by="anna"), step(3.0, "heal")), 5)
    assert {name: {robot for _, robot in found.values()} for name, found in files.items()} == {
        f"r{n}": {f"r{n}"} for n in range(1, 6)
    }


# Faults


class MovedRobot(Robot):
    """A robot that takes the line on an incident for the loss of its base."""

    def step(self, input: Input, now: float) -> Actions | None:
        """As `Robot.step`."""
        is_line = isinstance(input, NoteInput) and input.text.startswith("incident ")
        return super().step(DriverInput(False, "lost") if is_line else input, now)


def test_an_incident_that_stops_a_robot_breaks_a_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(swarm, "Robot", MovedRobot)
    fault = fault_of(3, MARKED)
    assert fault is not None
    assert fault.rule == "unmoved"


def ids(*parts: object) -> str:
    return next(_ids)


_ids = (f"{number:012x}" for number in range(1000))
ESTOP = (step(1.0, "estop", by="anna"),)


@pytest.mark.parametrize(
    ("steps", "owner", "name", "fake", "rule"),
    [
        (SPLIT, IncidentService, "on_beacon", lambda *_: None, "heard"),
        (SPLIT, IncidentService, "advance", lambda *_: None, "heard"),
        (ESTOP, core_incident, "id_of", ids, "heard"),
        (KILLED, incidents, "read_left", lambda path: None, "death"),
        (KILLED, incidents, "silent_id", ids, "death"),
        (MANY, incidents, "to_remove", lambda *_: [], "few"),
        (RESTARTED, IncidentService, "_may_begin", lambda *_, **__: True, "few"),
    ],
    ids=["not told", "not written", "own ids", "not read", "other ids", "not removed", "no limit"],
)
def test_a_fault_of_the_black_box_breaks_its_rule(
    monkeypatch: pytest.MonkeyPatch,
    steps: Steps,
    owner: Any,
    name: str,
    fake: Callable[..., Any],
    rule: str,
) -> None:
    monkeypatch.setattr(owner, name, fake)
    fault = fault_of(5 if steps is MANY else 3, steps)
    assert fault is not None
    assert fault.rule == rule


def test_the_oldest_files_give_way() -> None:
    files = kept(MANY, 5)
    assert all(len(one) <= INCIDENT_FILES // 2 for one in files.values())  # marks take half
