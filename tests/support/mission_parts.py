"""Small patterns as parts of missions, and missions from text."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from swarmd.core.errors import ConfigError, PluginError, unknown
from swarmd.core.values import Inputs, Outputs, Platform, Scalar, Scan, Twist, Value
from swarmd.kit.behavior import Context, MovementPattern, Pattern
from swarmd.kit.factory import assemble
from swarmd.kit.params import Params, about
from swarmd.kit.voting_pattern import VotingParams, VotingPattern
from swarmd.mission.mission import Mission, mission_class
from swarmd.settings.settings import load_platform

PLATFORM = load_platform("waffle_pi")


class GoParams(Params, frozen=True):
    speed: Annotated[float, about("speed", ge=0.0, le=1.0, unit="m/s")] = 0.1


class Go(MovementPattern[GoParams]):
    """Drives and counts its steps; refuses speed 0.666."""

    params_type = GoParams
    report_units = {"steps": "steps"}  # noqa: RUF012 - read only

    def __init__(self, params: GoParams, context: Context) -> None:
        super().__init__(params, context)
        self.steps = 0
        self.update(params)

    @classmethod
    def defaults(cls, platform: Platform) -> Mapping[str, Value]:
        return {"speed": 0.2}

    def update(self, params: GoParams) -> None:
        if params.speed == 0.666:
            raise ConfigError("not that speed")
        super().update(params)

    def report(self) -> Mapping[str, Scalar]:
        return {"steps": self.steps}

    def drive(self, inputs: Inputs) -> Twist:
        self.steps += 1
        return Twist(self.params.speed)


class Vote(VotingPattern[VotingParams]):
    """Keeps its opinion."""

    def decide(self, heard: Mapping[str, int]) -> int:
        return self.opinion


class Brief(Pattern[Params]):
    """Is done after three steps; sends and reports their number."""

    needs = frozenset[str]()
    channels = {"count": int}  # noqa: RUF012 - read only

    def __init__(self, params: Params, context: Context) -> None:
        super().__init__(params, context)
        self.count = 0

    def step(self, inputs: Inputs) -> Outputs:
        self.count += 1
        done = "three steps" if self.count >= 3 else None
        return Outputs(Twist(0.5), {"count": self.count}, {"count": self.count}, done)


KINDS: Mapping[str, type[Pattern[Any]]] = {"go": Go, "vote_on": Vote, "brief": Brief}


def find(name: str) -> type[Pattern[Any]]:
    if name not in KINDS:
        raise PluginError(unknown("pattern", name, KINDS))
    return KINDS[name]


def mission_of(folder: Path, text: str) -> type[Mission]:
    path = folder / "tried.yaml"
    path.write_text(text)
    return mission_class(path, find)


def made(
    folder: Path, text: str, platform: Platform = PLATFORM, seed: int = 5, **params: Value
) -> Mission:
    kind = mission_of(folder, text)
    pattern = assemble(
        "tried",
        (("run", params),),
        find=lambda name: kind if name == "tried" else find(name),
        robot="robot-1",
        platform=platform,
        rng=np.random.default_rng(seed),
    ).pattern
    assert isinstance(pattern, Mission)
    return pattern


def seen(range_: float = 3.0) -> Scan:
    return Scan(1, 0.0, np.full(8, range_), np.linspace(-3.0, 3.0, 8), 0.12, 3.5)


def steps(mission: Mission, *times: float, range_: float = 3.0, **more: Any) -> list[Outputs]:
    return [mission.step(Inputs(now, 0.1, scan=seen(range_), **more)) for now in times]
