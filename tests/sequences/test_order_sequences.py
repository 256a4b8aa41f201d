"""A run and a stop with faults of single messages: no rule breaks, and a broken one is found."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest

from swarmd.robot.issue_time import KnownStops
from tests.histories.swarm import Delivery
from tests.sequences.orders import FAULTS, MISSING, Cell, cells, main, messages, play, search


def test_all_cells_are_listed_once() -> None:
    listed = list(cells())
    assert len(listed) == len(set(listed)) == 4 * 20 * 20


@pytest.mark.parametrize("missing", MISSING)
def test_no_fault_of_a_message_lets_a_run_go_on_after_a_later_stop(missing: str) -> None:
    chance = random.Random(f"{missing}, 5")
    run, stop = sorted(chance.sample(range(20), 2))
    played, findings = search(Cell(missing, run, stop), 1, 0.1, chance)
    assert played > 4
    assert not findings


def test_two_faults_of_messages_break_no_rule() -> None:
    played, findings = search(Cell("none", 2, 6), 2, 0.002, random.Random(3))
    assert played > 4
    assert not findings


def test_a_lost_message_is_lost_and_a_late_one_late() -> None:
    first = Delivery("anna", "r1", "ask", 0)
    cell = Cell("none", 0, 19)
    assert first in messages(cell)
    counts = [
        play(cell, {first: FAULTS[name]})["anna", "r1", "ask"] for name in ("lost", "2 s late")
    ]
    assert counts == [2, 2]  # the request is repeated after 0.5 s without an answer
    assert play(cell, {})["anna", "r1", "ask"] == 1


def test_a_robot_that_forgets_stops_is_found(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A look waits for the absent robot, so the stop overtakes the run that was typed before it."""
    monkeypatch.setattr(KnownStops, "later_than", lambda self, start: "")
    played, findings = search(Cell("absent", 0, 5), 1, 1.0, random.Random(1))
    assert played == 1
    assert findings[0].text.startswith("rule stopped: r1 runs by `run` of before the stop")
    monkeypatch.setattr("tests.sequences.orders.cells", lambda: [Cell("absent", 0, 5)])
    assert main(tmp_path, []) == 1
    (file,) = tmp_path.iterdir()
    assert json.loads(file.read_text()) == ["absent", 0, 5, 1, 1]


def test_what_has_ended_is_not_played_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tests.sequences.orders.cells", lambda: [Cell("absent", 0, 5)])
    assert main(tmp_path, ["--share", "0.01"]) == 0
    first = capsys.readouterr().out
    monkeypatch.setattr("tests.sequences.orders.play", None)
    assert main(tmp_path, ["--share", "0.01"]) == 0
    assert capsys.readouterr().out == first
