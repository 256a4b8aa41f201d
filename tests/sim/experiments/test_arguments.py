"""The words of `exp run` are taken as they are meant, or answered in one line."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from decimal import Decimal
from typing import Any

import numpy as np
import pytest

import swarmd
from swarmd.core.errors import ConfigError
from swarmd.sim.experiments.plan import Shard, parse_seeds, parse_sets, parse_shard, parse_sweeps
from swarmd.sim.experiments.simulate import plan_of, simulate


@pytest.mark.parametrize(
    ("text", "seeds"),
    [
        ("3", (0, 1, 2)),
        ("500-502", (500, 501, 502)),
        ("3,5,9", (3, 5, 9)),
        ("9,3", (9, 3)),
        ("0-2,10", (0, 1, 2, 10)),
        ("7-7", (7,)),
        (" 1, 2 ", (1, 2)),
    ],
)
def test_seeds_are_a_number_of_them_a_range_or_a_list(text: str, seeds: tuple[int, ...]) -> None:
    assert parse_seeds(text) == seeds


@pytest.mark.parametrize(
    ("text", "subject"),
    [
        ("", "''"),
        ("0", "seeds"),
        ("-3", "'-3'"),
        ("5-3", "'5-3'"),
        ("1,,2", "''"),
        ("a", "'a'"),
        ("1.5", "'1.5'"),
        ("3,3", "seeds: 3"),
        ("0-4,2", "seeds: 2"),
        ("9999999", "at most 100000"),
        ("0-9999999", "at most 100000"),
        ("9999999999-9999999999", "4294967295"),
    ],
)
def test_invalid_seeds_are_named(text: str, subject: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_seeds(text)
    assert subject in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_duration_takes_a_unit() -> None:
    assert parse_sets(["duration=3min"]) == {"duration": 180.0}
    assert parse_sweeps(["duration=30s,1m,90"]) == {"duration": [30.0, 60.0, 90]}
    assert parse_sets(["name=3min"]) == {"name": "3min"}


def test_values_are_read_as_in_a_file() -> None:
    assert parse_sets(["a.b=5", "c=real", "d=0.1", "e=true", "f=[1, 2]", "g=null"]) == {
        "a.b": 5, "c": "real", "d": 0.1, "e": True, "f": [1, 2], "g": None,
    }  # fmt: skip


def test_sweeps_keep_their_order_and_types() -> None:
    found = parse_sweeps(["b=0.2,0.1,1e-3", "a=x,[1, 2],null, {a: 4, b: 5},'x,y'"])
    assert list(found.items()) == [
        ("b", [0.2, 0.1, 0.001]),
        ("a", ["x", [1, 2], None, {"a": 4, "b": 5}, "x,y"]),
    ]


@pytest.mark.parametrize(
    "word", ["speed", "=1,2", "a..b=1", "speed=", "a=1,", "a=,", "a=1,,2", "a=[1"]
)
def test_an_invalid_sweep_is_named(word: str) -> None:
    with pytest.raises(ConfigError, match="^--sweep .*" + re.escape(word.partition("=")[0])):
        parse_sweeps([word])


@pytest.mark.parametrize("parse", [parse_sets, parse_sweeps])
def test_a_key_given_twice_is_refused(parse: Callable[[list[str]], object]) -> None:
    with pytest.raises(ConfigError, match=" a "):
        parse(["a=1", "a=2"])


def test_a_part_is_counted_from_one() -> None:
    assert parse_shard("3/40") == Shard(3, 40)
    assert parse_shard(" 1/1 ") == Shard(1, 1)


@pytest.mark.parametrize("text", ["0/40", "41/40", "x", "", "3", "3/", "1/0", "-1/3", "1.5/3"])
def test_what_is_no_part_is_one_line(text: str) -> None:
    with pytest.raises(ConfigError, match="--shard") as caught:
        parse_shard(text)
    assert "\n" not in str(caught.value)


def test_values_of_numpy_are_numbers_and_lists() -> None:
    sweep: Any = {"groups.tb3.parameters.speed": np.linspace(0.1, 0.2, 2)}
    one: Any = np.int64(1)
    sets = {"groups.tb3.count": np.int64(3), "duration": np.float32(2.0)}
    plan = plan_of("dispersion", np.arange(2), sets, sweep)
    speeds = [variant.values["groups.tb3.parameters.speed"] for variant in plan.variants]
    assert speeds == [0.1, 0.2]
    assert plan.seeds == (0, 1)
    assert json.loads(json.dumps(plan.variants[0].effective["groups"]))["tb3"]["count"] == 3
    assert swarmd.env("dispersion", one, set=sets).scenario.effective["duration"] == 2.0
    swarmd.demo(robots=one, seed=one)  # not started


@pytest.mark.parametrize(
    ("sets", "seeds", "subject"),
    [
        ({"groups.tb3.count": Decimal(3)}, 1, "Decimal"),
        ({"duration": np.datetime64("2026-01-01")}, 1, "date"),
        ({}, 1.5, "seeds is 1.5"),
    ],
)
def test_a_wrong_type_is_named(sets: dict[str, object], seeds: int, subject: str) -> None:
    with pytest.raises(ConfigError, match=subject):
        simulate("dispersion", seeds=seeds, set=sets)
