"""Parameters of patterns: typed and bounded, each with a unit, a description and a source.

A pattern declares a frozen struct; `build` makes one from layers of values, weakest first, and
gives the source of each value. NaN and infinity are refused, also without bounds.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, cast, get_args, get_origin
from typing import get_type_hints as type_hints

import msgspec
import numpy as np
from msgspec import Meta, Struct

from swarmd.core.errors import ParameterError, PluginError, unknown
from swarmd.core.host_messages import REQUEST_LAYER, Layers
from swarmd.core.numbers import read_number
from swarmd.core.values import Platform, Scalar, Value

_TYPES: Mapping[object, str] = {float: "float", int: "int", bool: "bool", str: "str"}


Recovery = Annotated[
    bool,
    Meta(
        description="whether recovery leads the robot around what blocks it",
        extra={"unit": "", "source": "ours: without it two robots that meet head-on stay blocked"},
    ),
]

Avoidance = Annotated[
    Literal["platform", "orca", "none"],
    Meta(
        description="what leads the robot past moving ones; platform: as the platform's file says",
        extra={"unit": "", "source": "ours: acts only with recovery"},
    ),
]


class Params(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The parameters of one pattern: fields `name: Annotated[type, about(...)] = default`.

    - Type: float, int, bool, str or a Literal of strings; `Annotated[int, about(...)] | None` where
      None has a meaning.
    - Default: a field without a default is derived from the platform (see `about`) or required.
    - `__post_init__` may check several fields and raise ValueError.
    - Every pattern has `recovery` (protection leads a blocked robot around what blocks it) and
      `avoidance` (how recovery passes moving obstacles). A pattern that stops or pushes on purpose
      overrides the default: `recovery: Recovery = False`.
    """

    recovery: Recovery = True
    avoidance: Avoidance = "platform"


P = TypeVar("P", bound=Params)


def about(
    description: str,
    *,
    ge: float | None = None,
    le: float | None = None,
    unit: str = "",
    source: str = "",
    derived: Callable[[Platform], float] | None = None,
) -> Meta:
    """The meaning, bounds and unit of a parameter, and the source of its default.

    `derived` computes the default from the platform, for a field that declares no default. A lambda
    as `derived` may use only its argument, since annotations are evaluated outside of the module.
    """
    extra = {"unit": unit, "source": source, "derived": derived}
    return Meta(ge=ge, le=le, description=description, extra=extra)


def threshold(platform: Platform) -> float:
    """The distance in m that protection keeps free."""
    return float(platform.protection["threshold"])


def of_threshold(share: float) -> Callable[[Platform], float]:
    """For `about(derived=...)`: the function that gives `share` times `threshold`."""
    return lambda platform: share * threshold(platform)


def clear_distance(platform: Platform) -> float:
    """The distance in m from the axle at which turning in place does not activate protection."""
    return 1.06 * threshold(platform) + 1.3 * math.hypot(*platform.scan.offset)


def object_width(platform: Platform) -> float:
    """The width in m above which an object is not a robot: twice the footprint's diagonal."""
    return 2.0 * float(np.hypot(*np.ptp(platform.footprint, axis=0)))


TopSpeed = Annotated[
    float,
    about(
        "highest speed",
        ge=0.0,
        le=2.0,
        unit="m/s",
        source="ROS2swarm: the platform's limit, 0.5 m/s at most",
        derived=lambda platform: min(platform.limits.linear, 0.5),
    ),
]
TopTurn = Annotated[
    float,
    about(
        "highest turn rate",
        ge=0.0,
        le=4.0,
        unit="rad/s",
        source="ROS2swarm: the platform's limit",
        derived=lambda platform: min(platform.limits.angular, 4.0),
    ),
]
ObjectWidth = Annotated[
    float,
    about(
        "a wider object is not a robot",
        ge=0.05,
        le=10.0,
        unit="m",
        source="ours: twice the footprint's diagonal",
        derived=object_width,
    ),
]
SharePeriod = Annotated[
    float,
    about("time between two messages", ge=0.1, le=60.0, unit="s", source="ours"),
]
Lease = Annotated[
    float,
    about(
        "what was heard or sensed of a robot longer ago does not count",
        ge=0.2,
        le=600.0,
        unit="s",
        source="ours: several messages, so that a lost one does not matter",
    ),
]
WalkClearance = Annotated[
    float,
    about(
        "the walk turns away from nearer obstacles ahead",
        ge=0.0,
        le=20.0,
        unit="m",
        source="ours: that of random_walk leaves no way through 20 robots in 16 m2",
        derived=of_threshold(0.9),
    ),
]


@dataclass(frozen=True, slots=True)
class ParamSpec:
    """One parameter for tools to show; `default` is None if it is derived or `is_required`."""

    name: str
    type: str
    unit: str
    ge: float | None
    le: float | None
    default: Scalar | None
    description: str
    source: str
    choices: tuple[str, ...] = ()
    is_optional: bool = False
    is_required: bool = False

    @property
    def wanted(self) -> str:
        """The valid values in words: `a float from 0 to 2 m/s`."""
        if self.choices:
            text = "one of " + ", ".join(self.choices)
        else:
            article = "an" if self.type == "int" else "a"
            text = f"{article} {self.type}" + _bounds(self.ge, self.le)
        text += f" {self.unit}" if self.unit else ""
        return text + (" or none" if self.is_optional else "")


def schema(params_type: type[Params]) -> list[ParamSpec]:
    """The parameters of a pattern in the order of declaration, then the parameters of all patterns.

    PluginError for a type that neither YAML nor the command line can express.
    """
    return list(_declared(params_type).specs.values())


def build(
    params_type: type[P], layers: Layers
) -> tuple[P, Mapping[str, tuple[Scalar | None, str]]]:
    """Merge layers of parameter values; returns the parameters, and (value, source) of each.

    `layers` are (source, values), weakest first. A declared default has the source "pattern". Text
    is converted ("0.15", "true"), since the command line sends text. ParameterError, in one line,
    for the first wrong value: an unknown name, a wrong type, or a value out of bounds.
    """
    specs, hints, required, _ = _declared(params_type)
    # 1. The strongest value of each parameter.
    values: dict[str, Any] = {}
    sources = dict.fromkeys(specs, "pattern")
    for source, layer_values in layers:
        for name, value in layer_values.items():
            if name not in specs:
                raise ParameterError(f"{unknown('parameter', name, specs)} (from {source})", name)
            values[name] = _convert(value, hints[name], specs[name], source)
            sources[name] = source
    for name in required:
        if name not in values:
            wanted = specs[name].wanted
            raise ParameterError(f"parameter {name} has no default; give it {wanted}", name)
    # 2. The constructor fills in the defaults, and checks rules between parameters.
    try:
        params = params_type(**values)
    except ValueError as error:
        raise ParameterError(f"parameters do not fit together: {error}") from error
    return params, {name: (getattr(params, name), sources[name]) for name in specs}


def derived_defaults(params_type: type[Params], platform: Platform) -> dict[str, Value]:
    """The defaults that are computed from the platform (`derived` of `about`), by parameter."""
    derived = _declared(params_type).derived
    return {name: compute(platform) for name, compute in derived.items()}


class _Declared(NamedTuple):
    """The parameters by name, their type hints, those without a default, and those derived."""

    specs: Mapping[str, ParamSpec]
    hints: Mapping[str, Any]
    required: Sequence[str]
    derived: Mapping[str, Callable[[Platform], float]]


@lru_cache(maxsize=64)  # evaluating annotations takes 1 ms, and each run needs them
def _declared(params_type: type[Params]) -> _Declared:
    """The declaration of the parameters; PluginError for a wrong type or default."""
    hints = type_hints(params_type, include_extras=True)
    try:
        msgspec.inspect.type_info(params_type)
    except TypeError as error:
        raise PluginError(f"{params_type.__name__}: {error}") from error
    fields = _fields(params_type)
    specs = [_spec(params_type, field, hints[field.name]) for field in fields]
    for spec, field in zip(specs, fields, strict=True):
        if not field.required:
            _check_default(params_type, spec, hints[spec.name])
    required = [field.name for field in fields if field.required]
    computed = {name: (_unwrap(hints[name])[1].extra or {}).get("derived") for name in required}
    derived = {name: compute for name, compute in computed.items() if compute is not None}
    return _Declared({spec.name: spec for spec in specs}, hints, required, derived)


def _check_default(params_type: type[Params], spec: ParamSpec, hint: Any) -> None:
    """PluginError if the declared default has not the declared type or is out of bounds."""
    try:
        msgspec.convert(spec.default, hint)
    except msgspec.ValidationError:
        raise PluginError(
            f"{params_type.__name__}.{spec.name} has the default {spec.default!r};"
            f" expected {spec.wanted}"
        ) from None


def _convert(value: Value, hint: Any, spec: ParamSpec, source: str) -> Scalar | None:
    """A value from a layer in the type of its parameter; ParameterError if it does not fit."""
    if spec.is_optional and value in ("none", "null"):
        return None
    plain: Value = value
    if isinstance(value, str) and spec.type in ("int", "float"):
        number = read_number(value)
        plain = value if number is None else number
    elif spec.type == "str" and source == REQUEST_LAYER and type(value) in (int, float):
        plain = str(value)  # `exact_number` made it a number
    try:
        # Only text is converted: a YAML `1` is not a bool, a `true` not a number.
        converted = msgspec.convert(plain, hint, strict=not isinstance(plain, str))
    except msgspec.ValidationError:
        converted = math.nan
    if isinstance(converted, float) and not math.isfinite(converted):
        shown = repr(value) if value is None else f"{value!r} {spec.unit}".rstrip()
        raise ParameterError(
            f"parameter {spec.name} is {shown} (from {source}); expected {spec.wanted}", spec.name
        )
    return cast("Scalar | None", converted)


def _spec(params_type: type[Params], field: Any, hint: Any) -> ParamSpec:
    plain, meta, is_optional = _unwrap(hint)
    choices = get_args(plain) if get_origin(plain) is Literal else ()
    if plain not in _TYPES and not (choices and all(isinstance(c, str) for c in choices)):
        raise PluginError(
            f"{params_type.__name__}.{field.name} is a {plain}; "
            "expected float, int, bool, str or a Literal of strings"
        )
    extra = meta.extra or {}
    return ParamSpec(
        name=field.name,
        type="str" if choices else _TYPES[plain],
        unit=str(extra.get("unit", "")),
        ge=meta.ge,
        le=meta.le,
        default=None if field.required else field.default,
        description=meta.description or "",
        source=str(extra.get("source", "")),
        choices=choices,
        is_optional=is_optional,
        is_required=field.required and extra.get("derived") is None,
    )


def _fields(params_type: type[Params]) -> list[Any]:
    """The fields that the pattern declares, in order, then those of every pattern."""
    shared = Params.__struct_fields__
    return sorted(msgspec.structs.fields(params_type), key=lambda field: field.name in shared)


def _unwrap(hint: Any) -> tuple[Any, Meta, bool]:
    """The plain type, its meta and whether None is allowed."""
    meta = Meta()
    is_optional = False
    while True:
        if get_origin(hint) is Annotated:
            hint, *extras = get_args(hint)
            meta = next((extra for extra in extras if isinstance(extra, Meta)), meta)
        elif get_origin(hint) in (Union, types.UnionType) and type(None) in get_args(hint):
            others = [arm for arm in get_args(hint) if arm is not type(None)]
            if len(others) != 1:
                return hint, meta, True
            hint = others[0]
            is_optional = True
        else:
            return hint, meta, is_optional


def _bounds(ge: float | None, le: float | None) -> str:
    if ge is not None and le is not None:
        return f" from {ge:g} to {le:g}"
    if ge is not None:
        return f" of at least {ge:g}"
    return "" if le is None else f" of at most {le:g}"
