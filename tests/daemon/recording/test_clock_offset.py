"""Clock offsets by exchanges: the true offset lies within the stated error, whatever the delays."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable

import pytest

from swarmd.daemon.recording.clock_offset import Alignment, Exchange, align

HOURS = 3 * 3600.0
Clock = Callable[[float], float]
"""True time in s to what the clock shows."""


def steady(offset: float, drift: float = 0.0) -> Clock:
    return lambda true: offset + (1.0 + drift) * true


def exchange(
    own: tuple[str, Clock], peer: tuple[str, Clock], true: float, go: float, back: float
) -> Exchange:
    """A query at a true time whose way takes `go` s, and `back` s the answer's."""
    return Exchange(own[0], peer[0], own[1](true), peer[1](true + go), own[1](true + go + back))


def talk(
    clocks: dict[str, Clock],
    pairs: list[tuple[str, str]],
    *,
    seconds: float = 600.0,
    delay: Callable[[random.Random], tuple[float, float]] | None = None,
) -> list[Exchange]:
    """Exchanges of these pairs each 10 s, with delays of 1 to 20 ms and some of half a second."""
    rng = random.Random(1)

    def usual(rng: random.Random) -> tuple[float, float]:
        slow = 0.5 if rng.random() < 0.1 else 0.0
        return rng.uniform(0.001, 0.02) + slow, rng.uniform(0.001, 0.02)

    return [
        exchange((one, clocks[one]), (other, clocks[other]), 10.0 * k, *(delay or usual)(rng))
        for k in range(int(seconds / 10))
        for one, other in pairs
    ]


def worst(found: Alignment, clock: Clock, reference: Clock, seconds: float = 600.0) -> float:
    """The largest error of an alignment between the true times 0 and `seconds`."""
    times = [seconds * k / 100 for k in range(101)]
    return max(abs(found.to_reference(clock(t)) - reference(t)) for t in times)


def spans(clocks: dict[str, Clock], seconds: float = 600.0) -> dict[str, tuple[float, float]]:
    return {name: (clock(0.0), clock(seconds)) for name, clock in clocks.items()}


def test_clocks_hours_apart_that_drift_are_aligned_within_the_stated_error() -> None:
    clocks = {"a": steady(50.0), "b": steady(HOURS, 100e-6), "c": steady(-0.5 * HOURS, -100e-6)}
    pairs = list(itertools.permutations(clocks, 2))
    found = align(talk(clocks, pairs), spans(clocks), "a")
    for name, clock in clocks.items():
        assert worst(found[name], clock, clocks["a"]) <= found[name].error + 1e-9
        assert found[name].error < 0.012
    assert found["b"].offset == pytest.approx(HOURS - 50.0, abs=0.01)
    assert found["b"].drift == pytest.approx(100e-6, abs=15e-6)
    assert found["a"] == Alignment(50.0, 50.0, 1.0, 0.0, ())


@pytest.mark.parametrize("ways", [(0.0, 0.1), (0.1, 0.0), (0.3, 0.02)])
def test_asymmetric_delays_stay_within_half_of_the_round_trip(ways: tuple[float, float]) -> None:
    clocks = {"a": steady(0.0), "b": steady(HOURS, 50e-6)}
    found = align(talk(clocks, [("a", "b")], delay=lambda rng: ways), spans(clocks), "a")["b"]
    off = worst(found, clocks["b"], clocks["a"])
    assert abs(ways[0] - ways[1]) / 2 * 0.9 < off <= found.error + 1e-9
    assert found.error <= 1.06 * sum(ways) / 2


def test_the_error_grows_beyond_the_exchanges() -> None:
    clocks = {"a": steady(0.0), "b": steady(10.0, 100e-6)}
    few = talk(clocks, [("a", "b")], seconds=20.0)
    near = align(few, spans(clocks, 20.0), "a")["b"]
    far = align(few, spans(clocks, 3600.0), "a")["b"]
    assert worst(far, clocks["b"], clocks["a"], 3600.0) <= far.error
    assert far.error > near.error + 0.3
    (one,) = talk(clocks, [("b", "a")], seconds=10.0)
    single = align([one], spans(clocks, 3600.0), "a")["b"]
    assert worst(single, clocks["b"], clocks["a"], 3600.0) <= single.error


def test_a_clock_that_jumps_is_stated_as_an_error_of_that_size() -> None:
    def jumping(true: float) -> float:
        return true + (40.0 if true > 300.0 else 0.0)

    clocks: dict[str, Clock] = {"a": steady(0.0), "b": jumping}
    found = align(talk(clocks, [("a", "b")]), spans(clocks), "a")["b"]
    assert found.error >= worst(found, jumping, clocks["a"]) * 0.99
    assert found.error > 15.0


def test_a_reboot_makes_another_clock_with_an_offset_of_its_own() -> None:
    clocks = {"a": steady(0.0), "b-1": steady(9000.0, 80e-6), "b-2": steady(-290.0, 80e-6)}
    before = talk(clocks, [("a", "b-1")], seconds=300.0)
    after = [one for one in talk(clocks, [("a", "b-2")]) if one.sent > 300.0]
    found = align(before + after, {
        "b-1": (9000.0, 9300.0), "b-2": (10.0, 310.0)
    }, "a")  # fmt: skip
    assert found["b-1"].offset == pytest.approx(9000.0, abs=0.02)
    assert found["b-2"].offset == pytest.approx(-290.0, abs=0.05)


def test_clocks_without_exchanges_are_aligned_through_others_or_left_out() -> None:
    clocks = {name: steady(1000.0 * k, 20e-6 * k) for k, name in enumerate("abcde")}
    found = align(talk(clocks, [("a", "b"), ("c", "b"), ("d", "e")]), spans(clocks), "a")
    assert found.keys() == {"a", "b", "c"}
    assert found["c"].via == ("b",)
    assert found["c"].error > found["b"].error
    assert worst(found["c"], clocks["c"], clocks["a"]) <= found["c"].error


def test_the_path_with_the_smallest_error_is_taken() -> None:
    clocks = {"a": steady(0.0), "b": steady(5.0), "c": steady(9.0)}
    slow = talk(clocks, [("a", "c")], delay=lambda rng: (0.4, 0.4))
    quick = talk(clocks, [("a", "b"), ("b", "c")], delay=lambda rng: (0.001, 0.002))
    assert align(slow + quick, spans(clocks), "a")["c"].via == ("b",)
    assert align(slow, spans(clocks), "a")["c"].via == ()
