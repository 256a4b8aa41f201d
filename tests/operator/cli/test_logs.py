"""The lines of `logs`: each once, filtered, in the order of time; and links, worst first."""

from __future__ import annotations

import logging

import pytest

from swarmd.core.verbs import LinkReport, LinksReply, LogBatch, LogRecord, LogsQuery
from swarmd.operator.cli.links import pairs_of, summary
from swarmd.operator.cli.logs import _Printer


def batch(*numbers: int, life: str = "a", left_out: int = 0, level: int = logging.INFO) -> LogBatch:
    records = tuple(LogRecord(n, float(n), level, "pattern", f"line {n}") for n in numbers)
    return LogBatch(
        robot="r1",
        instance=life,
        now=100.0,
        last=max(numbers, default=0),
        records=records,
        left_out=left_out,
    )


def printer(**query: object) -> _Printer:
    return _Printer(["r1"], LogsQuery(**query), is_json=False)  # type: ignore[arg-type]


def test_each_record_is_printed_once_and_a_new_life_begins_anew() -> None:
    one = printer()
    found = [one.new_lines([found]) for found in (batch(1, 2), batch(2, 3), batch(1, life="b"))]
    assert [[line.record.seq for line in lines] for lines in found] == [[1, 2], [3], [1]]


def test_records_that_did_not_arrive_are_a_gap_and_those_left_out_by_a_filter_are_none() -> None:
    one = printer(grep="nothing", level=logging.WARNING)
    assert one.new_lines([batch(1, 2)]) == []
    assert not one.has_gap(batch(3, 4))
    assert one.has_gap(batch(5))
    assert one.has_gap(batch(2, life="b"))
    assert not one.has_gap(batch())


def test_what_was_left_out_is_told_once(capsys: pytest.CaptureFixture[str]) -> None:
    one = printer()
    for found in (batch(1, left_out=7), batch(2, left_out=7)):
        one.print_new([found])
    out, err = capsys.readouterr()
    assert len(out.splitlines()) == 2
    assert "\x1b" not in out
    assert len(err.splitlines()) == 1
    assert "7" in err


def test_links_are_shown_worst_first_and_one_way_pairs_are_named() -> None:
    good = LinkReport("r2", 32, 0, 0.5, 0.004, ("multicast",))
    bad = LinkReport("r1", 16, 16, 0.9, None, ("unicast",))
    replies = {
        "r1": LinksReply(robot="r1", links=(good,)),
        "r2": LinksReply(robot="r2", links=(bad,)),
    }
    pairs = pairs_of(replies, ["r1", "r2", "r3"])
    assert [(one.robot, one.other, one.loss) for one in pairs] == [
        ("r1", "r3", 1.0),
        ("r2", "r3", 1.0),
        ("r2", "r1", 0.5),
        ("r1", "r2", 0.0),
    ]
    lines = list(summary(pairs, 2))
    assert lines[0].startswith("4 pairs, the 2 worst")
    assert lines[1:3] == ["r1 does not hear r3", "r2 does not hear r3"]
    del replies["r2"]
    silent = LinksReply(robot="r2", links=())
    one_way = list(summary(pairs_of(replies | {"r2": silent}, ["r1", "r2"]), 9))
    assert "r2 does not hear r1, which hears it" in one_way
