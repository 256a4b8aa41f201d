"""Parameters: layers, provenance, and one clear line for every fault."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import pytest

from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.values import Value
from swarmd.kit.params import (
    Params,
    ParamSpec,
    TopSpeed,
    about,
    build,
    derived_defaults,
    of_threshold,
    schema,
)
from swarmd.settings.settings import load_platform


class Swirl(Params, frozen=True):
    radius: Annotated[float, about("how wide", ge=0.1, le=5.0, unit="m", source="a guess")] = 1.0
    turns: Annotated[int, about("how often", ge=1, le=9)] = 3
    is_left: Annotated[bool, about("which way")] = True
    shape: Annotated[Literal["round", "square"], about("what")] = "round"
    label: Annotated[str, about("a name")] = ""
    seconds: Annotated[float, about("at most", ge=0.0, le=1e6, unit="s")] | None = None
    free: float = 0.0


class Strict(Params, frozen=True, kw_only=True):
    low: Annotated[float, about("from", ge=0.0, le=9.0)] = 0.0
    high: Annotated[float, about("to", ge=0.0, le=9.0)]

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise ValueError(f"low is {self.low:g}, high {self.high:g}")


def one(**values: Value) -> Swirl:
    return build(Swirl, (("test", values),))[0]


def test_schema_has_all_declared_properties() -> None:
    assert schema(Swirl)[0] == ParamSpec(
        name="radius",
        type="float",
        unit="m",
        ge=0.1,
        le=5.0,
        default=1.0,
        description="how wide",
        source="a guess",
    )


def test_schema_has_types_choices_and_optionals() -> None:
    specs = {spec.name: spec for spec in schema(Swirl)}
    assert [spec.type for spec in specs.values()] == [
        *("float", "int", "bool", "str", "str", "float", "float", "bool", "str")
    ]
    assert specs["shape"].choices == ("round", "square")
    assert [name for name, spec in specs.items() if spec.is_optional] == ["seconds"]


def test_a_parameter_without_default_is_required() -> None:
    required = [spec.name for spec in schema(Strict) if spec.is_required]
    assert required == ["high"]
    with pytest.raises(ConfigError, match="high has no default"):
        build(Strict, ())


def test_the_strongest_layer_wins_and_is_named() -> None:
    layers = (("platform", {"radius": 2.0, "turns": 4}), ("robot", {"radius": 3.0}))
    params, sources = build(Swirl, layers)
    assert (params.radius, params.turns) == (3.0, 4)
    assert sources["radius"] == (3.0, "robot")
    assert sources["turns"] == (4, "platform")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ({"radius": "0.15"}, Swirl(radius=0.15)),
        ({"radius": 2}, Swirl(radius=2.0)),
        ({"turns": "4"}, Swirl(turns=4)),
        ({"is_left": "false"}, Swirl(is_left=False)),
        ({"is_left": "0"}, Swirl(is_left=False)),
        ({"shape": "square"}, Swirl(shape="square")),
        ({"label": "12"}, Swirl(label="12")),
        ({"seconds": "2.5"}, Swirl(seconds=2.5)),
        ({"seconds": "none"}, Swirl(seconds=None)),
        ({"seconds": None}, Swirl(seconds=None)),
    ],
)
def test_text_is_converted_to_the_type(text: dict[str, Value], value: Swirl) -> None:
    assert one(**text) == value


def test_an_integer_given_for_a_float_becomes_one() -> None:
    assert isinstance(one(radius=2).radius, float)


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"radius": 9}, "parameter radius is 9 m (from test); expected a float from 0.1 to 5 m"),
        ({"radius": "far"}, "parameter radius is 'far' m (from test); expected a float"),
        ({"radius": True}, "parameter radius is True m (from test); expected a float"),
        ({"turns": 2.5}, "parameter turns is 2.5 (from test); expected an int from 1 to 9"),
        ({"turns": "2.5"}, "parameter turns is '2.5' (from test); expected an int from 1 to 9"),
        ({"is_left": 1}, "parameter is_left is 1 (from test); expected a bool"),
        ({"shape": "oval"}, "parameter shape is 'oval' (from test); expected one of round, sq"),
        ({"label": 3}, "parameter label is 3 (from test); expected a str"),
        ({"radius": None}, "parameter radius is None (from test); expected a float from"),
        ({"radius": [1.0]}, "parameter radius is [1.0] m (from test); expected a float from"),
        (
            {"seconds": -1},
            "parameter seconds is -1 s (from test); expected a float from 0 to 1e+06 s or none",
        ),
        ({"radios": 1.0}, "no parameter 'radios'; did you mean 'radius'? (from test)"),
        ({"zzz": 1.0}, "no parameter 'zzz'; there are: avoidance, free, is_left, label, radius"),
    ],
)
def test_a_wrong_value_is_refused_in_one_line(values: dict[str, Value], line: str) -> None:
    with pytest.raises(ConfigError) as caught:
        one(**values)
    assert str(caught.value).startswith(line)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["radius", "free", "seconds"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "nan", "inf", "1e999"])
def test_nan_and_infinity_are_refused_with_or_without_bounds(name: str, value: Value) -> None:
    with pytest.raises(ConfigError, match=f"parameter {name} is"):
        one(**{name: value})


def test_a_wrong_value_is_an_error_even_if_a_stronger_layer_replaces_it() -> None:
    with pytest.raises(ConfigError, match="from platform"):
        build(Swirl, (("platform", {"radius": -1.0}), ("robot", {"radius": 1.0})))


def test_a_failed_post_init_check_is_a_config_error() -> None:
    with pytest.raises(ConfigError, match="low is 3, high 2"):
        build(Strict, (("test", {"low": 3.0, "high": 2.0}),))


class Listed(Params, frozen=True):
    points: list[float] = []  # noqa: RUF012 - msgspec copies it


class Unioned(Params, frozen=True):
    radius: Annotated[float | None, about("bounds over a union", ge=0.0)] = None


@pytest.mark.parametrize("kind", [Listed, Unioned])
def test_an_unsupported_type_is_a_plugin_error(kind: type[Params]) -> None:
    with pytest.raises(PluginError, match=kind.__name__):
        schema(kind)


class Derived(Params, frozen=True, kw_only=True):
    speed: TopSpeed
    slow: TopSpeed = 0.1
    gap: Annotated[float, about("gap", ge=0.0, le=9.0, derived=of_threshold(2.0))]


def test_a_default_derives_from_the_platform_unless_one_is_declared() -> None:
    platform = load_platform("burger")
    found = derived_defaults(Derived, platform)
    assert found == {"speed": 0.22, "gap": 2.0 * platform.protection["threshold"]}
    assert build(Derived, (("derived", found),))[1]["slow"] == (0.1, "pattern")
    assert not any(spec.is_required for spec in schema(Derived))
    with pytest.raises(ConfigError, match="speed has no default"):
        build(Derived, ())
