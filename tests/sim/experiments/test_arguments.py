"""The words of `exp run` are taken as they are meant, or answered in one line."""

from __future__ import annotations

import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.experiments.arguments import parse_seeds, parse_sets, parse_sweeps, split_values


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
    ("text", "fault"),
    [
        ("", "'' is not a seed"),
        ("0", "seeds"),
        ("-3", "'-3' is not a seed"),
        ("5-3", "'5-3' is not a seed"),
        ("1,,2", "'' is not a seed"),
        ("a", "'a' is not a seed"),
        ("1.5", "is not a seed"),
        ("3,3", "seeds: 3"),
        ("0-4,2", "seeds: 2"),
        ("9999999", "at most 100000"),
        ("0-9999999", "at most 100000"),
        ("9999999999-9999999999", "wanted whole numbers 0 to 4294967295"),
    ],
)
def test_seeds_that_cannot_be_are_one_line(text: str, fault: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_seeds(text)
    assert fault in str(caught.value)
    assert "\n" not in str(caught.value)


def test_commas_in_brackets_and_quotes_do_not_part_values() -> None:
    assert split_values("k", "1,[2,3], {a: 4, b: 5},'x,y'") == (
        "1", "[2,3]", "{a: 4, b: 5}", "'x,y'",
    )  # fmt: skip


def test_values_are_read_as_in_a_file() -> None:
    assert parse_sets(["a.b=5", "c=real", "d=0.1", "e=true", "f=[1, 2]", "g=null"]) == {
        "a.b": 5, "c": "real", "d": 0.1, "e": True, "f": [1, 2], "g": None,
    }  # fmt: skip


def test_sweeps_keep_their_order_and_types() -> None:
    found = parse_sweeps(["b=0.2,0.1,1", "a=x,[1, 2],null"])
    assert list(found.items()) == [("b", [0.2, 0.1, 1]), ("a", ["x", [1, 2], None])]


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["speed"], "--sweep 'speed': wanted is key=a,b,c"),
        (["=1,2"], "wanted is key=a,b,c"),
        (["a..b=1"], "wanted is key=a,b,c"),
        *(([f"speed={text}"], "a value is empty") for text in ("", "1,", ",", "1,,2")),
        (["a=1", "a=2"], "--sweep a is given twice"),
        (["a=[1"], "--sweep a: '[1'"),
    ],
)
def test_sweeps_that_cannot_be_are_one_line(words: list[str], fault: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_sweeps(words)
    assert fault in str(caught.value)


def test_a_value_set_twice_is_refused() -> None:
    with pytest.raises(ConfigError, match="--set a is given twice"):
        parse_sets(["a=1", "a=2"])
