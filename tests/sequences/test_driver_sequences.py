"""Sequences of a drone's flight and of drivers: no rule breaks, and broken flights are found."""

from __future__ import annotations

from itertools import pairwise, product

import pytest

from swarmd.core.values import Twist
from swarmd.drivers.crazyflie import flight
from swarmd.drivers.crazyflie.flight import TOUCH_HEIGHT, Flight, HoverSetpoint, Phase, Seen, Wish
from swarmd.testing import driver_contract
from tests.sequences.drivers import (
    ACTIONS,
    DRIVERS,
    FLIGHT_ACTIONS,
    BrokenRuleError,
    flights,
    walk,
    walk_of,
)
from tests.support import broken_drivers as broken_driver
from tests.support.wire import Good, Wire


def broken(depth: int) -> set[str]:
    """The rules that some sequence breaks."""
    return {text for _, text in flights(depth) if text}


def test_no_two_events_break_a_rule_of_flight() -> None:
    assert broken(2) == set()


@pytest.mark.evidence
def test_no_three_events_break_a_rule_of_flight() -> None:
    assert sum(1 for _, text in flights(3) if not text) == len(FLIGHT_ACTIONS) ** 3


def test_a_drone_that_starts_after_a_pause_of_the_daemon_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def starts(self: Flight, wish: Wish, seen: Seen) -> None:
        if wish is Wish.FLY and seen.may_fly:
            self.phase, self._target = Phase.TAKE_OFF, TOUCH_HEIGHT

    monkeypatch.setattr(Flight, "_on_ground", starts)
    assert any("motors start" in text for text in broken(2))


def test_a_drone_that_moves_while_it_is_to_hover_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    step = Flight.step

    def moves(
        self: Flight, now: float, wish: Wish, twist: Twist, seen: Seen
    ) -> HoverSetpoint | None:
        put = step(self, now, wish, twist, seen)
        return HoverSetpoint(twist, self._target) if self.phase is Phase.FLIGHT else put

    monkeypatch.setattr(Flight, "step", moves)
    assert "a drone moves that is not asked to" in broken(2)


def test_set_points_to_a_drone_that_is_not_heard_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flight, "BLIND_TIME", 5.0)
    assert "a drone that is not heard gets a set-point" in broken(2)


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_a_walk_has_each_sequence_once(depth: int) -> None:
    names = walk_of(tuple(ACTIONS), depth)
    windows = [tuple(names[at : at + depth]) for at in range(len(names) - depth + 1)]
    assert len(windows) == len(set(windows)) == len(ACTIONS) ** depth
    assert set(windows) == set(product(ACTIONS, repeat=depth))
    assert all(one[1:] == other[:-1] for one, other in pairwise(windows))


@pytest.mark.integration
@pytest.mark.parametrize(
    ("driver", "depth"),
    [
        ("simulated", 2),
        *(pytest.param(driver, 3, marks=pytest.mark.evidence) for driver in DRIVERS),
    ],
)
@pytest.mark.timeout(1200)
def test_no_sequence_breaks_a_rule_of_drivers(driver: str, depth: int) -> None:
    with DRIVERS[driver]() as rig:
        assert walk(rig, depth) == len(ACTIONS) ** depth


@pytest.mark.parametrize(
    "kind",
    [
        broken_driver.ResumesWithoutZero,
        broken_driver.QueuesCommands,
        broken_driver.DropsCommandsOfStoppedRobots,
        broken_driver.NeverReportsLost,
    ],
)
def test_a_broken_driver_is_found_by_the_walk(
    kind: type[Good], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_contract, "TIMEOUT", 2.0)
    with pytest.raises(BrokenRuleError):
        walk(Wire(kind), 2)


def test_a_driver_that_keeps_the_contract_passes_the_walk() -> None:
    assert walk(Wire(Good), 2) == len(ACTIONS) ** 2
