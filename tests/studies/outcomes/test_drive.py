"""Drive goes straight, at its speed, and stands before a wall: two runs, each claim a test."""

from __future__ import annotations

from functools import cache

from studies.outcomes.drive import outcomes
from studies.outcomes.outcome import Outcome


@cache
def found() -> tuple[Outcome, ...]:
    return tuple(outcomes((0, 1)))


def check(claim: str) -> None:
    (one,) = [outcome for outcome in found() if outcome.what.startswith(claim)]
    assert one.is_reached, f"{one.what}: {one.shown}; wanted {one.wanted}"


def test_drives_straight() -> None:
    check("most aside")


def test_drives_at_its_speed() -> None:
    check("speed")


def test_stands_before_the_wall() -> None:
    check("way in the last")


def test_keeps_room_to_the_wall() -> None:
    check("footprint")


def test_touches_nothing() -> None:
    check("touches")


def test_drives_a_circle() -> None:
    check("circle")


def test_every_outcome_is_asked_for() -> None:
    assert len(found()) == 6
