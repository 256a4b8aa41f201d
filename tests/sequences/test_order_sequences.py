"""Faults of single datagrams of a run and a stop; see `orders.py` for the whole search."""

from __future__ import annotations

import json
import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.verbs import StopRequest
from swarmd.robot import requests
from swarmd.robot.issue_time import IssueTime, KnownStops
from tests.histories import operators
from tests.sequences import orders
from tests.sequences.orders import Case, Cell, Fault, Sent, faults_behind, main, play

CELLS = (
    Cell("frozen", "open", 3, 4),
    Cell("absent", "secured", 0, 12),
    Cell("just booted", "open", 9, 2),
)
SINGLES, PAIRS = 8, 4  # of each cell
OPEN = CELLS[0]


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: cell.missing)
def test_the_last_order_wins_with_faults_of_two_datagrams(cell: Cell) -> None:
    chance = random.Random(1)
    singles = chance.sample([*faults_behind(play(cell).sent)], SINGLES)
    cases = [(at, play(cell, (fault,))) for at, fault in singles]
    for at, first in cases[:PAIRS]:
        seconds = [*faults_behind(first.sent, at + 1)]
        if seconds:
            cases.append((at, play(cell, (*first.faults, chance.choice(seconds)[1]))))
    assert [str(case) for _, case in cases if case.text] == []


def test_what_may_be_disturbed_is_orders_answers_and_the_look() -> None:
    """Of a run for a robot and a missing one: the reply, the stop and its repeat, their acks."""
    ways = {sent[:3] for sent in play(Cell("absent", "open", 0, 10)).sent}
    assert ways == {
        ("look", "anna", "r1"),
        ("beacon", "r1", "anna"),
        ("members", "r1", "anna"),
        ("run", "anna", "r1"),
        ("reply", "r1", "anna"),
        ("stop", "bob", "r1"),
        ("ack", "r1", "bob"),
    }


def test_a_robot_that_knows_no_stops_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The state before the rule of `issue_time.py`: no fault of the network is needed."""
    assert not play(OPEN).text
    monkeypatch.setattr(KnownStops, "later_than", lambda *_: "")
    assert "`run` of before the stop" in play(OPEN).text


def test_a_copy_that_ends_a_later_run_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot that takes each copy of a stop for as late as it comes: one fault shows it."""

    def late(robot: Any, request: StopRequest, now: float) -> requests._StopTime:
        is_copy = request.id in robot._executed
        return requests._StopTime(IssueTime.of(request, now - request.age), is_copy)

    cell = Cell("absent", "open", 3, 0)
    copied = Fault(Sent("stop", "bob", "r1", 0), "copied after 0.5 s")
    assert not play(cell, (copied,)).text
    monkeypatch.setattr(requests.RequestHandler, "_time_of", late)
    assert not play(cell).text
    assert "stands after the run" in play(cell, (copied,)).text


def test_a_stop_that_is_sent_once_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lost datagram is the shortest finding."""
    monkeypatch.setattr(operators, "STOP_PACE", ((1e9, 1e9),))
    cell = Cell("absent", "open", 0, 19)
    assert not play(cell).text
    lost = Fault(Sent("stop", "bob", "r1", 0), "lost")
    assert "after the stop" in play(cell, (lost,)).text


@pytest.mark.parametrize(
    ("change", "count"), [("lost", 0), ("copied after 2 s", 2), ("delayed by 0.5 s", 1)]
)
def test_a_change_is_carried_out(change: str, count: int) -> None:
    sent = Sent("run", "anna", "r1", 0)
    assert len(orders.CHANGES[change]) == count
    after = play(Cell("absent", "open", 0, 19), (Fault(sent, change),)).sent
    is_repeated = Sent("run", "anna", "r1", 1) in after  # after 0.5 s without a reply
    assert is_repeated == (count == 0 or change.startswith("delayed"))


def test_a_search_goes_on_behind_its_last_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played: list[Cell] = []

    def wrong(cell: Cell, faults: Sequence[Fault] = ()) -> Case:
        played.append(cell)
        return Case(cell, tuple(faults), "wrong")

    monkeypatch.setattr(orders, "play", wrong)
    words = ["--faults", "0", "--shard", "2/1200"]
    assert main(tmp_path, words) == 1
    assert len(played) == len(set(played)) == 2
    assert main(tmp_path, words) == 1
    assert len(played) == 2
    (path,) = tmp_path.iterdir()
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["histories"] for line in lines] == [1, 1]
    assert all("r2" in line["wrong"][0] for line in lines)
