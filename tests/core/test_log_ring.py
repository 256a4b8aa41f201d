"""The ring of log lines: bounded in number, length and rate, and searchable."""

from __future__ import annotations

import logging

from swarmd.core.log_ring import BURST, CAPACITY, LogRing
from swarmd.core.verbs import LOG_PAGE, MAX_LOG_LINE, LogsQuery

INFO, WARNING = logging.INFO, logging.WARNING


def filled(*texts: str) -> LogRing:
    ring = LogRing()
    for number, text in enumerate(texts):
        ring.add(float(number), INFO, "daemon", text)
    return ring


def test_the_latest_lines_are_kept() -> None:
    ring = LogRing()
    for number in range(CAPACITY + 10):
        ring.add(float(number), INFO, "daemon", str(number))
    records = ring.since(0)
    assert len(records) == LOG_PAGE
    assert records[-1].text == str(CAPACITY + 9)
    assert ring.last == records[-1].seq == CAPACITY + 10
    assert [one.seq for one in ring.since(ring.last - 2)] == [ring.last - 1, ring.last]


def test_a_line_is_searched_for_as_it_is_written() -> None:
    ring = filled("Loading drive", "a [.*] b", "loading x")
    ring.add(9.0, WARNING, "driver", "lost")

    def found(**query: object) -> list[str]:
        return [one.text for one in ring.matching(LogsQuery(**query))]  # type: ignore[arg-type]

    assert found(grep="LOADING") == ["Loading drive", "loading x"]
    assert found(grep="[.*]") == ["a [.*] b"]
    assert found(level=WARNING) == ["lost"]
    assert found(count=1, grep="loading") == ["loading x"]


def test_a_flood_of_one_source_hides_no_other_and_is_counted() -> None:
    ring = LogRing()
    for _ in range(10_000):
        ring.add(1.0, INFO, "pattern", "x")
    ring.add(1.0, WARNING, "daemon", "estopped")
    assert ring.left_out == 10_000 - BURST
    assert ring.since(0)[-1].text == "estopped"


def test_a_record_is_one_bounded_line() -> None:
    ring = filled("a\nb\x1b[2J" + "y" * 9999)
    (record,) = ring.since(0)
    assert record.text.startswith("a b [2J")
    assert len(record.text) == MAX_LOG_LINE
