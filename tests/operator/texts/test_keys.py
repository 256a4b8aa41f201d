"""Warnings about certificates and rosters, on the clock of who reads them."""

from __future__ import annotations

import pytest

from swarmd.core.finding import Level
from swarmd.core.messages import KeySummary, Status
from swarmd.operator.texts.doctor import identity
from swarmd.operator.texts.keys import day, end_of_certificate, key_warnings, own_end
from tests.support.statuses import status

DAY = 86400.0
NOW = 1_800_000_000.0


def of(robot: str, days: float, generation: int = 3) -> Status:
    return status(robot, keys=KeySummary(generation=generation, expires=int(NOW + days * DAY)))


@pytest.mark.parametrize(
    ("days", "words"),
    [
        (90, ""),
        (14.1, ""),
        (13.5, "in 13 days"),
        (1.2, "in 1 day"),
        (0.5, "in 12 h"),
        (-1, "has"),
    ],
)
def test_ends_are_warned_of_from_14_days_before(days: float, words: str) -> None:
    text = end_of_certificate(NOW + days * DAY, NOW)
    assert words in text
    assert bool(text) == bool(words)


@pytest.mark.parametrize("days", [90, -1])
def test_a_clock_that_was_not_set_knows_no_end(days: float) -> None:
    """The clock of a machine that booted without one: no certificate is called ended or valid."""
    expires = NOW + days * DAY
    assert "not been set" in end_of_certificate(expires, DAY)
    (line,) = key_warnings([of("r1", days)], DAY)
    assert "not been set" in line
    assert "keys renew" not in line
    finding = identity(expires, DAY)
    assert finding.level is Level.WARNING
    assert "not been set" in finding.text


def test_robots_with_one_end_share_a_line() -> None:
    lines = list(key_warnings([of("r1", 5.5), of("r2", 5.5), of("r3", 50), of("r4", -3)], NOW))
    assert len(lines) == 2
    assert "r1, r2" in lines[0]
    assert "r4" in lines[1]


def test_older_rosters_are_named() -> None:
    (line,) = key_warnings([of("r1", 50, 4), of("r2", 50, 3), of("r3", 50, 4)], NOW)
    assert "r2 (3" in line


def test_robots_without_keys_have_no_line() -> None:
    assert list(key_warnings([status("r1")], NOW)) == []


def test_days_are_those_of_utc() -> None:
    assert day(0) == "1970-01-01"


def test_an_own_certificate_that_has_ended_is_told() -> None:
    assert own_end("bob", NOW + 1.0, NOW) == ""
    assert "swarmctl keys bundle bob" in own_end("bob", NOW - 1.0, NOW)
