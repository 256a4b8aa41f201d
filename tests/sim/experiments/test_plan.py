"""A plan holds every run that was asked for, once, in order, or says what is wrong."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.errors import ConfigError
from swarmd.sim.experiments.plan import Plan, Run, Shard, Variant, make_plan


def planned(
    seeds: tuple[int, ...] = (0, 1),
    sets: Mapping[str, Any] | None = None,
    sweep: Mapping[str, Any] | None = None,
) -> Plan:
    return make_plan("gather", seeds, sets or {}, sweep or {}, lambda overrides: dict(overrides))


def test_a_sweep_is_the_full_grid_in_the_order_given() -> None:
    plan = planned((5, 3), {"duration": 9}, {"a.speed": [0.2, 0.1], "law": ["ours", "paper"]})
    assert [run.id for run in plan.runs] == [
        "speed=0.2,law=ours_s0005",
        "speed=0.2,law=ours_s0003",
        "speed=0.2,law=paper_s0005",
        "speed=0.2,law=paper_s0003",
        "speed=0.1,law=ours_s0005",
        "speed=0.1,law=ours_s0003",
        "speed=0.1,law=paper_s0005",
        "speed=0.1,law=paper_s0003",
    ]
    assert plan.variants[1].effective == {"duration": 9, "a.speed": 0.2, "law": "paper"}
    assert plan.variants[1].values == {"a.speed": 0.2, "law": "paper"}


def test_without_a_sweep_there_is_one_variant_without_a_name() -> None:
    plan = planned((500,))
    assert [variant.name for variant in plan.variants] == [""]
    assert [run.id for run in plan.runs] == ["s0500"]


def test_keys_with_equal_ends_get_distinct_names() -> None:
    plan = planned((0,), sweep={"a.count": [1], "b.count": [2]})
    assert plan.variants[0].name == "a.count=1,b.count=2"


@pytest.mark.parametrize("value", ["a/b", "../../x", "/etc", "a\\b", "x\n", "~", "é", "a b"])
def test_no_value_leads_out_of_the_folder(value: str) -> None:
    (run,) = planned((0,), sweep={"k": [value]}).runs
    assert run.id.startswith("k=")
    assert not set(run.id) - set("abcdefghijklmnopqrstuvwxyz0123456789=_.-")


@pytest.mark.parametrize("values", [["a/b", "a b", "A/b", "c"], ["x" * 300 + "1", "x" * 300 + "2"]])
def test_names_stay_apart_as_names_of_files(values: list[str]) -> None:
    runs = planned((0,), sweep={"k": values}).runs
    assert len({run.id.lower() for run in runs}) == len(values)
    assert max(len(run.id) for run in runs) < 200


@pytest.mark.parametrize(
    ("sets", "sweep", "fault"),
    [
        ({}, {"k": []}, "sweep k: "),
        ({}, {"k": [1, 2, 1]}, "sweep k: 1"),
        ({}, {"k": "abc"}, "sweep k: 'abc'"),
        ({"k": 1}, {"k": [1]}, "k is both"),
        ({"k.a": 1}, {"k": [{"a": 2}]}, "sweep k: k.a"),
        ({}, {"k.a": [1, 2], "k": [{"a": 3}]}, "sweep k: k.a"),
        ({}, {"a": list(range(1000)), "b": list(range(1000))}, "2000000 runs"),
    ],
)
def test_a_sweep_that_cannot_be_is_one_line(
    sets: dict[str, Any], sweep: dict[str, Any], fault: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        planned(sets=sets, sweep=sweep)
    assert fault in str(caught.value)


@pytest.mark.parametrize("seeds", [(), (1, 1), (-1,), (True,), (0.5,)])
def test_seeds_from_python_are_checked_too(seeds: tuple[Any, ...]) -> None:
    with pytest.raises(ConfigError, match="seeds: "):
        planned(seeds)


@pytest.mark.parametrize("of", [1, 2, 3, 7, 40])
def test_parts_are_disjoint_and_together_all_runs(of: int) -> None:
    plan = long_and_short(seeds=range(6))
    parts = [replace(plan, shard=Shard(k, of)).runs for k in range(1, of + 1)]
    ids = [run.id for part in parts for run in part]
    assert sorted(ids) == sorted(run.id for run in plan.runs)
    order = [run.id for run in plan.runs]
    for part in parts:
        places = [order.index(run.id) for run in part]
        assert places == sorted(places)


@given(
    durations=st.lists(st.floats(0.1, 100.0), min_size=1, max_size=8, unique=True),
    seeds=st.integers(1, 9),
    of=st.integers(1, 9),
)
def test_parts_are_equally_long_up_to_one_run(durations: list[float], seeds: int, of: int) -> None:
    plan = long_and_short(range(seeds), durations)
    parts = [replace(plan, shard=Shard(k, of)).runs for k in range(1, of + 1)]
    loads = [sum(run.robot_seconds for run in part) for part in parts]
    assert max(loads) - min(loads) <= max(run.robot_seconds for run in plan.runs) + 1e-9


def test_the_time_of_a_run_follows_robots_and_duration() -> None:
    groups = {"a": {"count": 3, "robots": None}, "b": {"count": None, "robots": ["x", "y"]}}
    variant = Variant("", {}, {"duration": 10.0, "groups": groups})
    assert Run("s0000", variant, 0).robot_seconds == 50.0


def test_there_is_no_part_beyond_the_last_or_before_the_first() -> None:
    for part, of in ((0, 3), (4, 3), (-1, 3), (1, 0)):
        with pytest.raises(ValueError, match="no part"):
            Shard(part, of)


def long_and_short(seeds: Iterable[int], durations: Sequence[float] = (10.0, 1.0, 5.0)) -> Plan:
    def effective(overrides: Mapping[str, Any]) -> Mapping[str, Any]:
        return {**overrides, "groups": {"all": {"count": 2}}}

    return make_plan("x", seeds, {}, {"duration": list(durations)}, effective)
