"""The study of faults: its rows can be run, and a short form names what a robot must name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from studies import faults
from studies.faults import AT, BEHAVIOURS, FAULTS, FAULTY, REMOVED, SOUND, Found, Record, Task
from tests.support.traces import trace_of


@pytest.mark.parametrize("pattern", BEHAVIOURS)
def test_each_row_gives_one_of_seven_robots_one_fault(pattern: str) -> None:
    for name in (SOUND, REMOVED, *FAULTS):
        made = faults.scenario(pattern, name)
        own = [event for event in made.events if event.at > 0.0]
        assert len(made.robots) == 7
        assert [event.robots for event in own] == [(FAULTY,)] * len(own)
        assert [event.at for event in own[:1]] == ([] if name == SOUND else [AT])


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


def test_what_was_said_before_the_fault_or_by_others_does_not_count() -> None:
    said = [[1.0, FAULTY, "before"], [AT + 3.5, FAULTY, "for 2.5 s"], [AT + 1.0, "tb3-01", "other"]]
    trace = trace_of(np.zeros((3, 2, 3)), ids=("tb3-01", FAULTY), meta={"said": said})
    trace = replace(trace, reason=None)
    assert dict(faults._said(trace, is_control=False)) == {"for # s": 3.5}
    assert set(dict(faults._said(trace, is_control=True))) == {"before", "for # s", "other"}
