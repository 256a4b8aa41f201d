"""Offsets of clocks by exchanges, and starts at one moment."""

from __future__ import annotations

import pytest

from swarmd.link.datagram import ClockReply
from swarmd.operator.session.clocks import (
    EXCHANGES,
    MAX_DRIFT,
    ClockOffset,
    ClockReadings,
    start_times,
)

AHEAD = 1234.5
"""What the robot's clock is ahead of the operator's, in s."""


def exchange(
    readings: ClockReadings, at: float, there: float, back: float, clock: bytes = b"abcdef"
) -> None:
    """A query at `at` that takes `there` and `back` s on the way."""
    query = readings.query(at)
    answered = round(1e9 * (at + there + AHEAD))
    reply = ClockReply(robot="r1", clock=clock, sent=query.sent, answered=answered)
    readings.on_reply(reply, at + there + back)


@pytest.mark.parametrize(("there", "back"), [(0.01, 0.01), (0.05, 0.001), (0.0, 0.08)])
def test_the_offset_lies_within_half_of_the_round_trip(there: float, back: float) -> None:
    readings = ClockReadings()
    exchange(readings, 10.0, there, back)
    found = readings.offsets["r1"]
    assert found.error == pytest.approx((there + back) / 2)
    assert abs(found.offset - AHEAD) <= found.error + 1e-6


def test_the_shortest_round_trip_counts() -> None:
    readings = ClockReadings()
    for trip in (0.2, 0.002, 0.1):
        exchange(readings, 10.0 + trip, trip, 0.0)
    assert readings.offsets["r1"].error == pytest.approx(0.001)


def test_answers_that_were_not_asked_for_are_ignored() -> None:
    readings = ClockReadings()
    readings.on_reply(ClockReply(robot="r1", clock=b"abcdef", sent=7, answered=9), 1.0)
    assert readings.offsets == {}


def test_readings_of_another_clock_are_dropped() -> None:
    readings = ClockReadings()
    exchange(readings, 10.0, 0.001, 0.001)
    exchange(readings, 11.0, 0.1, 0.1, clock=b"ghijkl")  # the robot was booted again
    assert readings.offsets["r1"].error == pytest.approx(0.1)


def test_a_robot_lacks_exchanges_until_there_are_enough() -> None:
    readings = ClockReadings()
    for number in range(EXCHANGES):
        assert readings.lacking(["r1", "r2"]) == {"r1", "r2"}
        exchange(readings, 10.0 + number, 0.01, 0.01)
    assert readings.lacking(["r1", "r2"]) == {"r2"}


def test_each_robot_starts_by_its_own_clock() -> None:
    offsets = {"r1": ClockOffset(100.0, 0.001, 50.0), "r2": ClockOffset(-20.0, 0.004, 50.0)}
    starts, skew = start_times(offsets, 53.0)
    assert starts == {"r1": 153.0, "r2": 33.0}
    assert skew == pytest.approx(0.005 + 2 * 3.0 * MAX_DRIFT)
    assert start_times({"r1": offsets["r1"]}, 53.0)[1] == 0.0
