"""Sequences of the drivers' actions; see `drivers.py` for the whole search."""

from __future__ import annotations

import asyncio
import json
import time
from pathlib import Path

import pytest

from swarmd.core.values import ZERO, Twist
from swarmd.driver_api.command_gate import CommandGate
from swarmd.drivers import simulated
from swarmd.drivers.crazyflie import driver as crazyflie
from swarmd.drivers.crazyflie.flight import Flight
from swarmd.drivers.ros1.master_graph import MasterGraph
from swarmd.drivers.ros2.command_credit import CommandCredit
from tests.sequences import drivers
from tests.sequences.drivers import fault_of, main, possible, search
from tests.sequences.virtual_loop import VirtualLoop, run_virtually

PAUSE = 1.2
EACH = {"simulated": 2, "crazyflie": 7, "ros1": 9, "ros2": 11}  # one of so many of depth 2


@pytest.mark.parametrize("name", EACH)
def test_no_sequence_breaks_a_rule(name: str) -> None:
    assert list(search(name, 1, (PAUSE,))) == []
    some = [*possible(name, 2)][:: EACH[name]]
    assert [fault for actions in some if (fault := fault_of(name, actions, PAUSE))] == []


# Faults, each with a sequence that shows it


def _hand_on_the_last(gate: CommandGate, twist: Twist, *, is_stopped: bool = False) -> Twist | None:
    last: Twist = getattr(gate, "last", ZERO)
    gate.last = twist  # type: ignore[attr-defined]
    gate._has_sent = True
    return last if gate.is_open else None


def _hand_on_all(gate: CommandGate, twist: Twist, *, is_stopped: bool = False) -> Twist | None:
    gate._has_sent = True
    return twist


def _hand_on_motion(gate: CommandGate, twist: Twist, *, is_stopped: bool = False) -> Twist | None:
    """No zero after the first command that moves the base."""
    has_moved = getattr(gate, "has_moved", False) or not twist.is_zero
    gate.has_moved = has_moved  # type: ignore[attr-defined]
    return None if has_moved and twist.is_zero else _hand_on_all(gate, twist)


def _hand_on_zero(gate: CommandGate, twist: Twist, *, is_stopped: bool = False) -> Twist | None:
    return ZERO


def _open_without_zero(gate: CommandGate) -> None:
    gate._is_open = True


def _close_without_zero(gate: CommandGate, now: float) -> bool:
    gate._is_open = False
    return False


def _rest_at_the_end(flight: Flight, text: str) -> None:
    _end(flight, text)
    flight._has_rested = True


_end = Flight._end
FAULTS: dict[str, tuple[str, tuple[str, ...], object, str, object, int]] = {
    "a command late": ("ros1", (), CommandGate, "filter", _hand_on_the_last, 1),
    "no zero to a silent world": (
        *("simulated", ("link lost",), CommandGate, "close", _close_without_zero, 1),
    ),
    "commands to a frozen hub": (
        *("ros2", ("link lost",), CommandCredit, "offer", lambda credit, twist, now: twist, 1),
    ),
    "commands to a lost base": ("ros1", ("owner",), CommandGate, "filter", _hand_on_all, 2),
    "the last command again": (
        *("ros2", ("link closed",), CommandGate, "open", _open_without_zero, 3),
    ),
    "a climb after a loss": ("crazyflie", ("link lost",), Flight, "_end", _rest_at_the_end, 4),
    "no zero after a stop": ("simulated", ("stop",), CommandGate, "filter", _hand_on_motion, 5),
    "a silence unnoticed": (
        "simulated",
        ("link lost", "run"),
        simulated,
        "SENSOR_TIMEOUT",
        60.0,
        6,
    ),
    "an owner unnoticed": ("ros1", ("owner",), MasterGraph, "blocks", False, 7),
    "a hazard untold": ("crazyflie", ("hazard",), crazyflie, "_hazards", lambda info: (), 8),
    "no motion": ("simulated", (), CommandGate, "filter", _hand_on_zero, 9),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_breaks_its_rule(monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    name, actions, where, what, value, rule = FAULTS[fault]
    monkeypatch.setattr(where, what, value)
    assert fault_of(name, actions, PAUSE).startswith(f"rule {rule}:")


def test_sequences_are_those_that_change_something() -> None:
    """Seven actions are possible at first; after a loss the link can only come back."""
    first = {"run", "stop", "link lost", "link closed", "base restarted", "battery low", "hazard"}
    assert {actions[0] for actions in possible("simulated", 1)} == first
    after_a_loss = {second for one, second in possible("simulated", 2) if one == "link lost"}
    assert after_a_loss == first - {"link lost", "link closed"} | {"link back"}


def test_a_search_shows_the_shortest_and_is_not_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played: list[object] = []

    def fault(name: str, actions: tuple[str, ...], pause: float) -> str:
        played.append(actions)
        return "rule 3" if "link lost" in actions else ""

    monkeypatch.setattr(drivers, "fault_of", fault)
    words = ["--depth", "2", "--driver", "simulated"]
    assert main(tmp_path, words) == 1
    lines = [json.loads(line) for line in (tmp_path / "drivers-2.jsonl").read_text().splitlines()]
    assert [line["pause"] for line in lines] == list(drivers.PAUSES)
    assert all(line["faults"][0].startswith("simulated, link lost, each") for line in lines)
    assert ("link lost", "stop") not in played
    count = len(played)
    assert main(tmp_path, words) == 1
    assert len(played) == count


def test_virtual_time_passes_at_once() -> None:
    loop, seen = VirtualLoop(), list[float]()

    async def story() -> None:
        begin = loop.time()
        loop.call_later(5.0, lambda: seen.append(loop.time() - begin))
        await asyncio.sleep(3600.0)
        seen.append(loop.time() - begin)

    began = time.monotonic()
    run_virtually(loop, story())
    assert seen == pytest.approx([5.0, 3600.0], abs=1e-3)
    assert time.monotonic() - began < 600.0


def test_an_error_that_only_the_loop_sees_is_raised() -> None:
    loop = VirtualLoop()

    async def story() -> None:
        loop.call_soon(_fail)
        await asyncio.sleep(0.1)

    with pytest.raises(ZeroDivisionError):
        run_virtually(loop, story())


def _fail() -> None:
    raise ZeroDivisionError
