"""Conditions: read from files and command lines, and watched from step to step."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Scan
from swarmd.kit.condition_state import Facts, Watch
from swarmd.kit.conditions import (
    AllOf,
    AnyOf,
    Compared,
    Condition,
    Done,
    Nearer,
    Not,
    Settled,
    Timeout,
    needs_of,
    parse_condition,
    parse_conditions,
    read_condition,
)
from swarmd.kit.diagnostics import Faults


def scan(*ranges: float) -> Scan:
    return Scan(1, 0.0, np.array(ranges), np.zeros(len(ranges)), 0.12, 3.5)


def met(condition: Condition, *facts: Facts, began: float = 0.0) -> list[bool]:
    watch = Watch(condition)
    watch.begin(began)
    return [watch.is_met(one) for one in facts]


def at(now: float, **reports: Any) -> Facts:
    return Facts(now, reports)


@pytest.mark.parametrize(
    ("data", "condition"),
    [
        ({"timeout": 20}, Timeout(20.0)),
        ({"done": "vote"}, Done("vote")),
        ({"settled": "vote.opinion", "for": 5}, Settled("vote.opinion", 5.0)),
        ({"nearer": 0.4}, Nearer(0.4)),
        ({"report": "vote.opinion", "is": 2}, Compared("vote.opinion", "is", 2)),
        ({"reading": "light", "above": -3}, Compared("light", "above", -3.0, True)),
        ({"any": [{"timeout": 1}, {"done": "a"}]}, AnyOf((Timeout(1.0), Done("a")))),
        ({"all": [{"not": {"nearer": 1}}]}, AllOf((Not(Nearer(1.0)),))),
    ],
)
def test_reads_each_kind(data: Any, condition: Condition) -> None:
    faults = Faults()
    assert read_condition(data, ("until",), faults) == condition
    assert faults.found == []


@pytest.mark.parametrize(
    ("data", "keys", "words"),
    [
        (20, ("until",), "wanted a condition"),
        ({}, ("until",), "says nothing; wanted one of timeout"),
        ({"timeout": 2, "nearer": 1}, ("until",), "put them under any"),
        ({"timeout": 0}, ("until", "timeout"), "above 0"),
        ({"timeout": math.inf}, ("until", "timeout"), "wanted a number"),
        ({"timeout": True}, ("until", "timeout"), "wanted a number"),
        ({"timeout": 2, "four": 1}, ("until", "four"), "no key 'four'"),
        ({"settled": "a.b"}, ("until", "for"), "is missing"),
        ({"report": "a.b"}, ("until",), "wanted one of is, above, below"),
        ({"report": "a.b", "is": 1, "above": 0}, ("until",), "is and above"),
        ({"reading": "light", "is": 1}, ("until", "is"), "no key 'is'"),
        ({"report": "a.b", "is": [1]}, ("until", "is"), "wanted a number, text"),
        ({"any": []}, ("until", "any"), "list of conditions"),
        ({"all": [{"done": 3}]}, ("until", "all", 0, "done"), "the name of a part"),
    ],
)
def test_a_wrong_one_is_told_of_with_its_place(data: Any, keys: Any, words: str) -> None:
    faults = Faults()
    assert read_condition(data, ("until",), faults) is None
    ((place, text),) = faults.found
    assert place == keys
    assert words in text


@pytest.mark.parametrize(
    ("text", "condition"),
    [
        ("done", Done()),
        ("timeout:2.5", Timeout(2.5)),
        ("nearer:0.4", Nearer(0.4)),
        ("settled:vote.opinion:5", Settled("vote.opinion", 5.0)),
        ("report:state=settled", Compared("state", "is", "settled")),
        ("report:opinion=2", Compared("opinion", "is", 2)),
        ("report:ok=true", Compared("ok", "is", True)),
    ],
)
def test_parses_a_command_line(text: str, condition: Condition) -> None:
    assert parse_condition(text) == condition


@pytest.mark.parametrize(
    "text", ["", "don", "done:x", "timeout", "timeout:-1", "nearer:nan", "settled:5", "report:x"]
)
def test_what_is_no_condition_is_refused_with_the_forms_there_are(text: str) -> None:
    with pytest.raises(ConfigError, match=r"wanted (one of timeout:SECONDS|such as 5)"):
        parse_condition(text)


@pytest.mark.parametrize("texts", ["done", 3, [], ["done"] * 17, [3], ["d" * 201], {"a": 1}])
def test_what_comes_over_the_network_is_a_short_list(texts: object) -> None:
    with pytest.raises(ConfigError, match="until"):
        parse_conditions(texts)


def test_several_mean_any_of_them() -> None:
    assert parse_conditions(["done", "nearer:1"]) == AnyOf((Done(), Nearer(1.0)))


def test_time_counts_from_the_beginning() -> None:
    assert met(Timeout(20.0), at(119.9), at(120.0), began=100.0) == [False, True]


def test_settled_is_since_the_last_change() -> None:
    facts = [at(0.0), at(1.0, o=1), at(3.0, o=2), at(5.9, o=2), at(6.0, o=2), at(7.0, o=1)]
    assert met(Settled("o", 3.0), *facts) == [False, False, False, False, True, False]


def test_nearer_counts_what_is_too_close_to_measure_and_not_what_is_unknown() -> None:
    facts = [
        Facts(0.0, {}, scan=some)
        for some in (None, scan(math.nan, math.inf), scan(0.5), scan(0.3), scan(-math.inf))
    ]
    assert met(Nearer(0.4), *facts) == [False, False, False, True, True]


def test_done_is_of_a_part_or_of_the_whole() -> None:
    facts = Facts(0.0, {}, done=("move",))
    assert met(Done("move"), facts) == [True]
    assert met(Done("vote"), facts) == [False]
    assert met(Done(), facts, Facts(0.0, {}, done=("",))) == [False, True]


def test_values_are_compared_by_kind() -> None:
    assert met(Compared("a", "above", 1.0), at(0.0, a=1), at(0.0, a=1.1), at(0.0, a="2")) == [
        False,
        True,
        False,
    ]
    assert met(Compared("a", "below", 1.0), at(0.0, a=0), at(0.0)) == [True, False]
    assert met(Compared("a", "is", "1"), at(0.0, a=1), at(0.0, a="1")) == [False, True]
    light = Facts(0.0, {}, readings={"light": 3.0})
    assert met(Compared("light", "above", 2.0, True), light) == [True]
    assert met(Compared("light", "above", 2.0), light) == [False]


def test_combinations_ask_all_of_theirs_each_time() -> None:
    # The second would start to count only at 2 s if it were not asked before.
    both = AllOf((Timeout(2.0), Settled("o", 2.0)))
    assert met(both, at(0.0, o=1), at(2.0, o=1)) == [False, True]
    either = AnyOf((Timeout(1.0), Nearer(1.0)))
    assert met(either, at(0.5), at(1.0)) == [False, True]
    assert met(Not(Timeout(1.0)), at(0.5), at(1.0)) == [True, False]


def test_a_robot_must_sense_what_is_asked_of() -> None:
    condition = AnyOf((Nearer(1.0), Not(Compared("light", "above", 1.0, True)), Timeout(1.0)))
    assert needs_of(condition) == {"scan", "reading:light"}
