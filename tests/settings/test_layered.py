"""Merging and typing of configuration from several sources."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import pytest
from msgspec import Meta, Struct

from swarmd.core.errors import ConfigError
from swarmd.settings.layered import Keys, Layered, fault_at, read


class Inner(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    speed: Annotated[float, Meta(gt=0.0, le=2.0)]
    count: Annotated[int, Meta(ge=1)] = 1


class Outer(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    inner: Inner
    name: str = "x"
    mode: Literal["a", "b"] = "a"
    flag: bool = False
    points: list[tuple[float, float]] = []
    groups: dict[str, Inner] = {}
    maybe: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    perhaps: Inner | None = None


GOOD = {"inner": {"speed": 1.0}}


def test_the_strongest_source_wins_key_by_key_and_lists_are_replaced() -> None:
    weak = {"inner": {"speed": 1.0, "count": 3}, "points": [[0, 0], [1, 1]]}
    strong = {"inner": {"speed": 2}, "points": [[5, 5]]}
    file = Layered(("strong", strong), ("weak", weak)).build(Outer)
    assert file.inner == Inner(speed=2.0, count=3)
    assert file.points == [(5.0, 5.0)]


def test_knows_the_source_of_each_key() -> None:
    layers = Layered(("strong", {"inner": {"speed": 2}}), ("weak", {"inner": {"count": 3}}))
    assert layers.source("inner", "speed") == "strong"
    assert layers.source("inner", "count") == "weak"
    assert layers.source("name") is None


def test_does_not_change_its_sources() -> None:
    weak = {"inner": {"speed": 1.0}}
    Layered(("strong", {"inner": {"speed": 2}}), ("weak", weak)).build(Outer)
    assert weak == GOOD


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        ({}, "inner is missing; expected keys and values: speed, count"),
        ({"inner": {}}, "inner.speed is missing; expected a number above 0 and up to 2"),
        *(
            (
                {"inner": {"speed": bad}},
                f"inner.speed is {bad!r}; expected a number above 0 and up to 2",
            )
            for bad in (0, 2.1, math.nan, math.inf, "1", True, None)
        ),
        ({"inner": {"spede": 1}}, "inner has no key 'spede'; did you mean 'speed'?"),
        ({"iner": {}}, "no key 'iner'; did you mean 'inner'?"),
        ({"inner": 5}, "inner is 5; expected keys and values: speed, count"),
        (
            {**GOOD, "inner": {"speed": 1, "count": 1.5}},
            "inner.count is 1.5; expected a whole number of at least 1",
        ),
        ({**GOOD, "name": False}, "name is False; expected text (put it in quotes)"),
        ({**GOOD, "mode": "c"}, "mode is 'c'; expected a or b"),
        ({**GOOD, "flag": "on"}, "flag is 'on'; expected true or false"),
        ({**GOOD, "points": [[0, 0], [1]]}, "points[1] is [1]; expected [a number, a number]"),
        ({**GOOD, "points": [[0, "x"]]}, "points[0][1] is 'x'; expected a number"),
        ({**GOOD, "points": {}}, "points is {}; expected a list, each [a number, a number]"),
        (
            {**GOOD, "groups": {"red": {"speed": -1}}},
            "groups.red.speed is -1; expected a number above 0 and up to 2",
        ),
        ({**GOOD, "maybe": 3}, "maybe is 3; expected a number of at least 0 and up to 1 or null"),
        ({**GOOD, "perhaps": {"speed": -1}}, "perhaps.speed is -1; expected a number above 0"),
        ({**GOOD, "inner": {"speed": 10**400}}, "inner.speed is 1"),
    ],
)
def test_a_fault_names_source_key_value_and_wanted_type(
    data: dict[str, object], fault: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        Layered(("x.yaml", data)).build(Outer)
    assert str(caught.value).startswith(f"x.yaml: {fault}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("inner", "fault"), [({"speed": -1}, "speed is -1"), ({}, "speed is missing")]
)
def test_a_fault_names_the_source_of_its_key_or_section(inner: object, fault: str) -> None:
    layers = Layered(("a.yaml", {"name": "y"}), ("b.yaml", {"inner": inner}))
    with pytest.raises(ConfigError, match=rf"^b\.yaml: inner\.{fault}"):
        layers.build(Outer)


def test_a_key_missing_everywhere_names_the_home_source() -> None:
    sources = ("strong", {"name": "y"}), ("weak", {"flag": True})
    with pytest.raises(ConfigError, match=r"^strong: inner is missing"):
        Layered(*sources).build(Outer)
    with pytest.raises(ConfigError, match=r"^weak: inner is missing"):
        Layered(*sources, home="weak").build(Outer)


def test_a_key_that_cannot_be_printed_leaves_the_fault_on_one_line() -> None:
    class Named(Struct, forbid_unknown_fields=True):
        limits: dict[str, float]

    with pytest.raises(ConfigError) as raised:
        Layered(("file", {"limits": {"a\nb é": []}})).build(Named)
    assert str(raised.value) == r"file: limits.a\nb é is []; expected a number"


class Square(Struct, frozen=True, tag="side", forbid_unknown_fields=True):
    side: float


class Row(Struct, frozen=True, tag="row", forbid_unknown_fields=True):
    row: Annotated[tuple[Square | Row, ...], Meta(min_length=1)]
    gap: float = 0.0

    def __post_init__(self) -> None:
        if self.gap < 0.0:
            raise ValueError("needs a gap of at least 0")


def test_the_key_that_is_a_tag_selects_the_struct() -> None:
    assert read({"row": [{"side": 1}, {"row": [{"side": 2}]}]}, Square | Row) == (
        Row((Square(1.0), Row((Square(2.0),)))),
        [],
    )


@pytest.mark.parametrize(
    ("data", "places"),
    [
        ({"row": [{"side": "x"}, {}, {"side": 1, "row": []}, {"row": []}]}, [0, 1, 2, 3]),
        ({"row": [{"side": 1, "colour": 2}, {"side": 1}, {"row": [{}], "gap": "x"}]}, [0, 2, 2]),
        ({"row": [{"row": [{"side": 1}], "gap": -1}]}, [0]),
    ],
)
def test_all_faults_are_found_with_their_places(data: object, places: list[int]) -> None:
    value, faults = read(data, Square | Row)
    assert value is None
    assert [keys[1] for keys, _ in faults] == places


def test_a_check_sees_each_valid_struct_with_its_place() -> None:
    seen: list[Keys] = []

    def check(value: object, keys: Keys) -> list[tuple[Keys, str]]:
        seen.append(keys)
        return [fault_at((*keys, "side"), "is odd")] if value == Square(1.0) else []

    _, faults = read({"row": [{"side": 1}, {"side": "x"}, {"side": 2}]}, Square | Row, check)
    assert seen == [("row", 0), ("row", 2)]
    assert [keys for keys, _ in faults] == [("row", 0, "side"), ("row", 1, "side")]
    with pytest.raises(ConfigError, match=r"^a\.yaml: side is odd"):
        Layered(("a.yaml", {"side": 1})).build(Square, check)


def test_the_outermost_struct_is_read_without_its_faulty_fields() -> None:
    value, faults = read({**GOOD, "name": 3, "groups": {"a": {}, "b": {"speed": 1}}}, Outer)
    assert value == Outer(inner=Inner(speed=1.0), groups={"b": Inner(speed=1.0)})
    assert [keys for keys, _ in faults] == [("name",), ("groups", "a", "speed")]
