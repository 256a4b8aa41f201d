"""Makes a pattern object with its parameters, and its parts the same way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from numpy.random import Generator

from swarmd.core.errors import MissingSensorError, PluginError
from swarmd.core.host_messages import MAX_SCAN_DELAY, Layers
from swarmd.core.keys import check_id
from swarmd.core.values import Platform, Scalar, Value, input_fault, lacks_text
from swarmd.kit.behavior import Context, Pattern
from swarmd.kit.params import build
from swarmd.kit.touch import check_zone

Find: TypeAlias = Callable[[str], type[Pattern[Any]]]
"""Gives the class of a pattern by name; PluginError for an unknown name."""


@dataclass(frozen=True, slots=True, eq=False)
class Assembled:
    """A pattern ready to be stepped. `params`: name -> (value, source)."""

    pattern: Pattern[Any]
    params: Mapping[str, tuple[Scalar | None, str]]


def full_layers(kind: type[Pattern[Any]], platform: Platform, layers: Layers) -> Layers:
    """The layers above the defaults that derive from the platform (source "derived")."""
    return (("derived", kind.defaults(platform)), *layers)


def assemble(
    name: str,
    layers: Layers,
    *,
    find: Find,
    robot: str,
    platform: Platform,
    rng: Generator,
    channel_prefix: str = "",
) -> Assembled:
    """Make the pattern called `name` for one robot, with the patterns that it contains.

    UnknownPatternError for an unknown name, MissingSensorError if the platform lacks a sensor,
    ParameterError for a wrong parameter, PluginError for a wrong class.

    Args:
        name: of the pattern.
        layers: the parameters as (source, values), weakest first.
        find: returns the class of a pattern.
        robot: the id of the robot.
        platform: of the robot.
        rng: the random generator of the pattern.
        channel_prefix: put before the names of the message channels of the pattern; empty for a
            pattern that no other pattern contains.
    """
    kind = find(name)
    _check_needs(name, kind.needs, platform)
    params, sources = build(kind.params_type, full_layers(kind, platform, layers))

    def make(
        inner_name: str, /, *, part: str = "", private: bool = False, **inner_params: Value
    ) -> Pattern[Any]:
        """Make a pattern that the pattern contains, as `Make` in behavior.py says."""
        # On the network the channels of a stand-alone pattern are named <pattern>/<channel>. A part
        # has the same channels unless it is private.
        prefix = f"{part or inner_name}-" if private else f"{inner_name}/"
        platform_params = platform.patterns.get(inner_name, {})
        return assemble(
            inner_name,
            (("platform", platform_params), (name, inner_params)),
            find=find,
            robot=robot,
            platform=platform,
            rng=rng.spawn(1)[0],  # an independent generator
            channel_prefix=prefix,
        ).pattern

    pattern = kind(params, Context(robot, platform, rng, make, channel_prefix))
    _check_needs(name, pattern.needs, platform)  # may differ from `kind.needs` by its parameters
    _check_channels(name, pattern.channels)
    check_zone(name, pattern.touches)
    check_scan_delay(name, pattern.scan_delay)
    return Assembled(pattern, sources)


def check_scan_delay(pattern: str, delay: object) -> None:
    """PluginError if a pattern asks to drive with scans that are later than any robot permits."""
    if not isinstance(delay, float | int) or not 0.0 <= delay <= MAX_SCAN_DELAY:
        raise PluginError(
            f"pattern {pattern!r}: scan_delay is {delay!r}; expected 0 to {MAX_SCAN_DELAY:g} s"
        )


def _check_channels(name: str, channels: Mapping[str, type]) -> None:
    for channel in channels:
        for chunk in channel.split("/"):
            check_id(chunk, f"a channel of pattern {name!r}")


def _check_needs(name: str, needs: frozenset[str], platform: Platform) -> None:
    for need in sorted(needs):
        fault = input_fault(need)
        if fault:
            raise PluginError(f"`needs` of {name!r}: {fault}; to hear messages needs no entry")
    if lack := lacks_text(needs, platform):
        if needs - platform.provides == {"neighbors"}:
            lack += "; to hear messages it needs nothing, so leave neighbors out if that is all"
        raise MissingSensorError(f"pattern {name!r} {lack}")
