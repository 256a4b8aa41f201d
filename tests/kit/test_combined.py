"""Patterns made of patterns: steps, channels, privacy, needs; and how all are assembled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, PluginError, unknown
from swarmd.core.values import Inputs, Message, Outputs, Platform, Twist, Value
from swarmd.kit.behavior import MovementPattern, Pattern
from swarmd.kit.combined import CombinedPattern
from swarmd.kit.factory import Assembled, assemble
from swarmd.kit.params import Params, about
from swarmd.settings.settings import load_platform

PLATFORM = load_platform("burger")


class Talker(Pattern[Params]):
    """Says how many words it has heard and how long its last step lasted."""

    channels = {"words": int}  # noqa: RUF012 - read only
    needs = frozenset({"odometry"})

    def __init__(self, params: Params, context: Any) -> None:
        super().__init__(params, context)
        self.draw = float(context.rng.random())

    def step(self, inputs: Inputs) -> Outputs:
        heard = sum(1 for message in inputs.messages if message.channel == "words")
        return Outputs(messages={"words": heard}, report={"dt": round(inputs.dt, 6)})


class MoverParams(Params, frozen=True):
    speed: Annotated[float, about("speed", ge=0.0, le=2.0)] = 0.1


class Mover(MovementPattern[MoverParams]):
    """Drives at the speed of its parameter."""

    params_type = MoverParams

    @classmethod
    def defaults(cls, platform: Platform) -> Mapping[str, Value]:
        return {"speed": platform.limits.linear}

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(self.params.speed)


class Both(CombinedPattern[Params]):
    """One part that talks with stand-alone talkers, one only with its like, one that moves."""

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        make = self.context.make
        return {
            "open": make("talker", part="open"),
            "closed": make("talker", part="closed", private=True),
            "move": make("mover", part="move"),
        }


class Nested(CombinedPattern[Params]):
    """A combined pattern as a part."""

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        return {"inner": self.context.make("both", part="inner", private=True)}


KINDS: Mapping[str, type[Pattern[Any]]] = {
    "talker": Talker,
    "mover": Mover,
    "both": Both,
    "nested": Nested,
}


def find(name: str) -> type[Pattern[Any]]:
    if name not in KINDS:
        raise PluginError(unknown("pattern", name, KINDS))
    return KINDS[name]


def put_together(name: str, platform: Platform = PLATFORM, **params: Value) -> Assembled:
    return assemble(
        name,
        (("run", params),),
        find=find,
        robot="robot-1",
        platform=platform,
        rng=np.random.default_rng(3),
    )


def step(pattern: Pattern[Any], now: float, *channels: str) -> Outputs:
    messages = tuple(Message("robot-2", channel, 1, 0.0) for channel in channels)
    return pattern.step(Inputs(now=now, dt=0.1, messages=messages))


def test_messages_of_parts_get_outer_names() -> None:
    pattern = put_together("both").pattern
    assert dict(pattern.channels) == {"talker/words": int, "closed-words": int}
    assert set(step(pattern, 0.0).messages) == {"talker/words", "closed-words"}


def test_each_part_receives_only_its_own_channels() -> None:
    pattern = put_together("both").pattern
    outputs = step(pattern, 0.0, "talker/words", "talker/words", "closed-words", "words", "other")
    assert outputs.messages == {"talker/words": 2, "closed-words": 1}


def test_a_part_of_a_part_keeps_its_shared_name() -> None:
    pattern = put_together("nested").pattern
    assert set(pattern.channels) == {"talker/words", "inner-closed-words"}
    outputs = step(pattern, 0.0, "talker/words", "inner-closed-words", "closed-words")
    assert outputs.messages == {"talker/words": 1, "inner-closed-words": 1}


def test_its_needs_are_those_of_its_parts() -> None:
    assert put_together("both").pattern.needs == {"scan", "odometry"}


def test_first_command_counts_and_reports_name_the_part() -> None:
    outputs = step(put_together("both").pattern, 0.0)
    assert outputs.twist is None  # the mover needs a scan
    assert set(outputs.report) == {"open.dt", "closed.dt"}


def test_a_part_that_is_stepped_rarely_gets_the_whole_dt() -> None:
    pattern = put_together("both").pattern
    assert isinstance(pattern, Both)
    pattern.step_part("open", Inputs(now=1.0, dt=0.1))
    pattern.step_part("closed", Inputs(now=1.5, dt=0.1))
    assert pattern.step_part("open", Inputs(now=2.0, dt=0.1)).report == {"dt": 1.0}


def test_it_is_done_when_all_its_parts_are() -> None:
    pattern = put_together("both").pattern
    assert isinstance(pattern, Both)
    done, not_done = Outputs(done="arrived"), Outputs()
    inputs = Inputs(now=0.0, dt=0.0)
    assert pattern.combine({"a": done, "b": not_done}, inputs).done is None
    assert pattern.combine({"a": done, "b": done}, inputs).done == "arrived; arrived"


def test_parts_draw_from_generators_of_their_own() -> None:
    pattern = put_together("both").pattern
    assert isinstance(pattern, Both)
    first, second = pattern.parts["open"], pattern.parts["closed"]
    assert isinstance(first, Talker)
    assert isinstance(second, Talker)
    assert first.draw != second.draw
    assert first.context.rng is not second.context.rng
    assert first.context.rng is not pattern.context.rng


def test_parameters_derive_from_the_platform_below_all_other_layers() -> None:
    assert put_together("mover").params["speed"] == (0.22, "derived")
    assert put_together("mover", speed="0.1").params["speed"] == (0.1, "run")


def test_parts_take_the_platforms_parameters() -> None:
    platform = replace(PLATFORM, patterns={"mover": {"speed": 0.05}})
    pattern = put_together("both", platform).pattern
    assert isinstance(pattern, Both)
    assert pattern.parts["move"].params.speed == 0.05


def test_a_wrong_parameter_of_a_part_names_its_source() -> None:
    both = put_together("both").pattern
    with pytest.raises(ConfigError, match=r"speed is 9 \(from both\)"):
        both.context.make("mover", speed=9)


def test_a_pattern_with_an_unmet_need_is_refused() -> None:
    platform = replace(PLATFORM, provides=frozenset({"scan"}))
    with pytest.raises(PluginError, match="'talker' needs odometry"):
        put_together("talker", platform)
