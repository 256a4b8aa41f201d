"""The study of faults: its rows can be run, and a short form names what a robot must name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from msgspec.structs import replace as replaced

from studies import faults
from studies.faults import AT, BEHAVIOURS, FAULTS, FAULTY, REMOVED, SOUND, Found, Record, Task
from tests.support.traces import trace_of


@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize("pattern", BEHAVIOURS)
def test_each_row_gives_one_or_two_of_seven_robots_one_fault(pattern: str, number: int) -> None:
    for name in (SOUND, REMOVED, *FAULTS):
        made = faults.scenario(Task(pattern, name, 0, number))
        begin = [event for event in made.events if event.at == AT]
        assert len(made.robots) == 7
        assert all(event.at >= AT for event in made.events if event.at > 0.0)
        wanted = [] if name == SOUND else [("tb3-04",), ("tb3-06",)][:number]
        assert [event.robots for event in begin] == wanted


def test_a_frozen_lidar_is_named_within_3_s_and_not_without_the_fault() -> None:
    frozen, sound = (
        faults.perform(Task("dispersion", fault, 1)).found for fault in ("scan frozen", SOUND)
    )
    (text,) = [text for text in frozen.said if "stopped" in text]
    assert 0.5 < frozen.said["frozen_scan"] < 3.0  # 1 s without a change: docs/evidence/sensing.md
    assert "frozen_scan" in text
    assert not {text, "frozen_scan"} & sound.said.keys()


def record(fault: str, said: dict[str, float], outcome: float, own: int = 0) -> Record:
    found = Found(said=said, touches=own, own=own, others=0, outcome=outcome)
    return Record(Task("flocking", fault, 0), found)


def test_a_text_of_runs_without_a_fault_names_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "BEHAVIOURS", {"flocking": BEHAVIOURS["flocking"]})
    records = [record(fault, {"usual": 3.0}, 1.0) for fault in (SOUND, REMOVED, *FAULTS)]
    records[2:4] = [
        record("scan frozen", {"usual": 1.0, "new": 4.0}, 2.0, own=3),
        record("scan blind, 90 deg ahead", {"new": 0.5}, 2.0),
    ]
    first, _, head, _, *rows = faults.table(records).splitlines()
    assert first.index("scan mirrored 0 of 1") < first.index("scan frozen 1 of 1")
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    by_fault = {row[2]: row[3:] for row in cells}
    assert head.count("|") == 12
    assert by_fault["scan frozen"] == ["4.0 s", "1 of 1", "3.0", "3", "0", "2", "1", "1"]
    assert by_fault["scan mirrored"][:2] == ["never", "0 of 1"]


def test_runs_with_two_faulty_robots_stand_beside_those_with_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The seeds of both count, and those of one robot alone do not."""
    monkeypatch.setattr(faults, "BEHAVIOURS", {"flocking": BEHAVIOURS["flocking"]})
    names = (SOUND, REMOVED, *FAULTS)
    of_one = [record(fault, {}, 1.0 if fault == SOUND else 2.0) for fault in names]
    of_one += [replace(one, task=replaced(one.task, seed=1)) for one in of_one]
    of_one[-1] = replace(of_one[-1], found=replaced(of_one[-1].found, outcome=9.0))
    of_two = [record(fault, {}, 4.0, own=3) for fault in (REMOVED, *FAULTS)]
    first, _, head, _, *rows = faults.table_of_two(of_two, of_one).splitlines()
    assert first == "Seeds: 1."
    assert head.count("|") == 10
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert [row[1] for row in cells] == list(FAULTS)
    assert cells[-1][2:] == ["3.0", "3", "0", "4", "2", "1", "4"]


def test_what_was_said_before_the_fault_or_by_others_does_not_count() -> None:
    robot = FAULTY[0]
    said = [[1.0, robot, "before"], [AT + 3.5, robot, "for 2.5 s"], [AT + 1.0, "tb3-01", "other"]]
    trace = trace_of(np.zeros((3, 2, 3)), ids=("tb3-01", robot), meta={"said": said})
    trace = replace(trace, reason=None)
    assert dict(faults._said(trace, is_control=False)) == {"for # s": 3.5}
    assert set(dict(faults._said(trace, is_control=True))) == {"before", "for # s", "other"}
