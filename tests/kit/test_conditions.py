"""Conditions: read from files and command lines, and evaluated from step to step."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Neighbor, Scan
from swarmd.kit.condition_state import ConditionState, Observation
from swarmd.kit.conditions import (
    AllOf,
    AnyOf,
    Condition,
    Done,
    Nearer,
    Neighbors,
    Not,
    Probability,
    Reading,
    Reported,
    Settled,
    Timeout,
    needs_of,
    parse_condition,
    parse_conditions,
)
from swarmd.settings.layered import read


def scan(*ranges: float) -> Scan:
    return Scan(1, 0.0, np.array(ranges), np.zeros(len(ranges)), 0.12, 3.5)


def met(condition: Condition, *seen: Observation, started: float = 0.0) -> list[bool]:
    state = ConditionState(condition)
    state.start(started)
    return [state.is_met(one) for one in seen]


def at(now: float, **reports: Any) -> Observation:
    return Observation(now, reports)


@pytest.mark.parametrize(
    ("data", "condition"),
    [
        ({"timeout": 20}, Timeout(20.0)),
        ({"done": "vote"}, Done("vote")),
        ({"settled": "vote.opinion", "for": 5}, Settled("vote.opinion", 5.0)),
        ({"nearer": 0.4}, Nearer(0.4)),
        ({"report": "vote.opinion", "is": 2}, Reported("vote.opinion", 2)),
        ({"reading": "light", "above": -3}, Reading("light", above=-3.0)),
        ({"neighbors": 3, "within": 0.8}, Neighbors(3.0, 0.8)),
        ({"probability": 0.1}, Probability(0.1)),
        ({"any": [{"timeout": 1}, {"done": "a"}]}, AnyOf((Timeout(1.0), Done("a")))),
        ({"all": [{"not": {"nearer": 1}}]}, AllOf((Not(Nearer(1.0)),))),
    ],
)
def test_reads_each_kind_from_a_file(data: Any, condition: Condition) -> None:
    assert read(data, Condition) == (condition, [])


@pytest.mark.parametrize(
    ("data", "keys", "subject"),
    [
        (20, (), "20"),
        ({}, (), "timeout"),
        ({"timeout": 2, "nearer": 1}, ("timeout",), "timeout and nearer"),
        ({"timeout": 0}, ("timeout",), "above 0"),
        ({"timeout": math.inf}, ("timeout",), "inf"),
        ({"timeout": True}, ("timeout",), "True"),
        ({"timeout": 2, "four": 1}, ("four",), "'four'"),
        ({"settled": "a.b"}, ("settled",), "missing"),
        ({"report": "a.b"}, (), "is, above, below"),
        ({"report": "a.b", "is": 1, "above": 0}, (), "is, above, below"),
        ({"reading": "light", "is": 1}, ("is",), "'is'"),
        ({"report": "a.b", "is": [1]}, ("is",), "[1]"),
        ({"probability": 0}, ("probability",), "above 0"),
        ({"probability": 1.5}, ("probability",), "1.5"),
        ({"neighbors": -1}, ("neighbors",), "-1"),
        ({"neighbors": 2, "slope": 101}, ("slope",), "101"),
        ({"any": []}, ("any",), "[]"),
        ({"all": [{"done": 3}]}, ("all", 0, "done"), "3"),
    ],
)
def test_a_malformed_condition_is_a_fault_at_its_key(data: Any, keys: Any, subject: str) -> None:
    condition, ((place, text),) = read(data, Condition)
    assert condition is None
    assert place == keys
    assert subject in text


@pytest.mark.parametrize(
    ("text", "condition"),
    [
        ("done", Done()),
        ("timeout:2.5", Timeout(2.5)),
        ("nearer:0.4", Nearer(0.4)),
        ("settled:vote.opinion:5", Settled("vote.opinion", 5.0)),
        ("report:state=settled", Reported("state", "settled")),
        ("report:opinion=2", Reported("opinion", 2)),
        ("report:ok=true", Reported("ok", True)),
    ],
)
def test_parses_the_short_forms(text: str, condition: Condition) -> None:
    assert parse_condition(text) == condition


@pytest.mark.parametrize(
    "text", ["", "don", "done:x", "timeout", "timeout:-1", "nearer:nan", "settled:5", "report:x"]
)
def test_a_malformed_text_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="expected"):
        parse_condition(text)


@pytest.mark.parametrize("texts", ["done", 3, [], ["done"] * 17, [3], ["d" * 201], {"a": 1}])
def test_only_a_short_list_is_accepted_from_the_network(texts: object) -> None:
    with pytest.raises(ConfigError, match="until"):
        parse_conditions(texts)


def test_several_conditions_mean_any_of_them() -> None:
    assert parse_conditions(["done", "nearer:1"]) == AnyOf((Done(), Nearer(1.0)))


def test_a_timeout_counts_from_the_start() -> None:
    assert met(Timeout(20.0), at(119.9), at(120.0), started=100.0) == [False, True]


def test_settled_counts_from_the_last_change() -> None:
    seen = [at(0.0), at(1.0, o=1), at(3.0, o=2), at(5.9, o=2), at(6.0, o=2), at(7.0, o=1)]
    assert met(Settled("o", 3.0), *seen) == [False, False, False, False, True, False]


def test_nearer_counts_minus_infinity_but_not_nan() -> None:
    seen = [
        Observation(0.0, {}, scan=some)
        for some in (None, scan(math.nan, math.inf), scan(0.5), scan(0.3), scan(-math.inf))
    ]
    assert met(Nearer(0.4), *seen) == [False, False, False, True, True]


def test_done_refers_to_a_part_or_the_whole_pattern() -> None:
    seen = Observation(0.0, {}, done=("move",))
    assert met(Done("move"), seen) == [True]
    assert met(Done("vote"), seen) == [False]
    assert met(Done(), seen, Observation(0.0, {}, done=("",))) == [False, True]


def test_values_are_compared_as_written() -> None:
    assert met(Reported("a", above=1.0), at(0.0, a=1), at(0.0, a=1.1), at(0.0, a="2")) == [
        False,
        True,
        False,
    ]
    assert met(Reported("a", below=1.0), at(0.0, a=0), at(0.0)) == [True, False]
    some = (at(0.0, a=10), at(0.0, a="010"), at(0.0, a="10"), at(0.0, a=10.5))
    assert met(Reported("a", "010"), *some) == [True, True, False, False]
    assert met(Reported("a", 10), *some) == [True, False, True, False]
    assert met(Reported("a", "ten"), *some) == [False] * 4
    light = Observation(0.0, {}, readings={"light": 3.0})
    assert met(Reading("light", above=2.0), light) == [True]
    assert met(Reported("light", above=2.0), light) == [False]


def test_combinations_evaluate_all_conditions_at_each_step() -> None:
    # The second would start to count only at 2 s if it were not asked before.
    both = AllOf((Timeout(2.0), Settled("o", 2.0)))
    assert met(both, at(0.0, o=1), at(2.0, o=1)) == [False, True]
    either = AnyOf((Timeout(1.0), Nearer(1.0)))
    assert met(either, at(0.5), at(1.0)) == [False, True]
    assert met(Not(Timeout(1.0)), at(0.5), at(1.0)) == [True, False]


def test_needs_follow_from_nearer_readings_and_neighbors() -> None:
    condition = AnyOf((Nearer(1.0), Not(Reading("light", above=1.0)), Timeout(1.0)))
    assert needs_of(condition) == {"scan", "reading:light"}
    assert needs_of(Neighbors(1.0)) == {"neighbors"}
    assert needs_of(AllOf((Neighbors(1.0, 0.5), Probability(0.1)))) == {"neighbors.distance"}


def test_neighbors_within_a_distance_are_counted() -> None:
    one, far, unknown = (Neighbor(id, 0.0, d) for id, d in (("a", 0.5), ("b", 2.0), ("c", None)))
    seen = [Observation(0.0, {}, neighbors=some) for some in ((), (one,), (one, far, unknown))]
    assert met(Neighbors(2.0), *seen) == [False, False, True]
    assert met(Neighbors(1.0, within=0.5), *seen) == [False, True, True]
    assert met(Neighbors(2.0, within=1.0), *seen) == [False, False, False]


def share(condition: Condition, period: float, **seen: Any) -> float:
    """How often the condition holds within a second from its start, of 2000 times."""
    rng = np.random.default_rng(1)
    steps = round(1.0 / period)
    times = [index * period for index in range(steps + 1)]
    found = [
        any(met(condition, *(Observation(now, {}, rng=rng, **seen) for now in times)))
        for _ in range(2000)
    ]
    return sum(found) / len(found)


@pytest.mark.parametrize("period", [0.5, 0.1])
def test_a_probability_is_that_of_a_second_at_any_rate(period: float) -> None:
    # Four standard deviations of a share of 2000.
    assert share(Probability(0.3), period) == pytest.approx(0.3, abs=0.041)


@pytest.mark.parametrize(("slope", "wanted"), [(2.0, 0.881), (-2.0, 0.119), (0.0, 0.5)])
def test_a_slope_makes_the_neighbour_count_of_automode(slope: float, wanted: float) -> None:
    # 1 / (1 + exp(slope (count - n))) for n = 3, count = 2.
    some = tuple(Neighbor(id, 0.0, 0.5) for id in "abc")
    found = share(Neighbors(2.0, 1.0, slope), 0.25, neighbors=some)
    assert found == pytest.approx(wanted, abs=0.045)


def test_a_certain_draw_holds_from_the_second_evaluation_on() -> None:
    seen = [Observation(now, {}, rng=np.random.default_rng(1)) for now in (5.0, 5.1, 5.2)]
    assert met(Probability(1.0), *seen, started=5.0) == [False, True, True]


def test_time_before_another_condition_held_does_not_add_to_a_draw() -> None:
    # The floor is white for 1000 s, then dark for 1 ms.
    dark = AllOf((Reading("ground", below=0.5), Probability(0.5)))
    rng = np.random.default_rng(1)
    seen = [
        Observation(now, {}, readings={"ground": ground}, rng=rng)
        for now, ground in ((0.0, 1.0), (1000.0, 1.0), (1000.001, 0.0))
    ]
    assert met(dark, *seen) == [False, False, False]
