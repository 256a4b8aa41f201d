"""Discussed dispersion: the robots agree on a distance and spread until they keep it.

Source: Kaiser et al., ICRA 2022, pattern "discussed dispersion" and experiment 2. The robots rest
for 20 s and vote by the majority rule. Then majority rule and dispersion run in parallel. Opinions
0, 1 and 2 stand for the distances 0.6, 1.0 and 1.4 m.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import msgspec

from swarmd.api import (
    CombinedPattern,
    ConfigError,
    Context,
    Initial,
    Inputs,
    Opinions,
    Outputs,
    Params,
    Pattern,
    Platform,
    Recovery,
    Scalar,
    TieRule,
    TopSpeed,
    TopTurn,
    WindowLength,
    about,
    of_threshold,
    threshold,
)

_VOTE = "vote"
_MOVE = "move"
_OF_VOTE = ("opinions", "initial", "window", "ties")
_OF_MOVE = ("law", "speed", "turn")


class DiscussedDispersionParams(Params, frozen=True, kw_only=True):
    """Duration of the vote and meaning of the opinions; then those of vote and motion."""

    discuss: Annotated[
        float,
        about(
            "time for which the robots stand and only vote",
            ge=0.0,
            le=3600.0,
            unit="s",
            source="paper, experiment 2",
        ),
    ] = 20.0
    base: Annotated[
        float,
        about(
            "distance of opinion 0; more than the protection threshold",
            ge=0.05,
            le=100.0,
            unit="m",
            source="paper, experiment 2: 1.2 times the protection threshold",
            derived=of_threshold(1.2),
        ),
    ]
    step: Annotated[
        float,
        about(
            "additional distance of each further opinion",
            ge=-100.0,
            le=100.0,
            unit="m",
            source="paper, experiment 2: 0.8 times the protection threshold",
            derived=of_threshold(0.8),
        ),
    ]
    opinions: Opinions = 3
    initial: Initial | None = None
    window: WindowLength = 5.0
    ties: TieRule = "random"
    law: Annotated[
        Literal["settling", "paper"],
        about(
            "how dispersion drives; settling: comes to rest; paper: the original equations",
            source="ours: the original drives at full speed forever",
        ),
    ] = "settling"
    speed: TopSpeed
    turn: TopTurn
    recovery: Recovery = False

    def __post_init__(self) -> None:
        """Check what bounds of single fields cannot."""
        if self.initial is not None and self.initial >= self.opinions:
            raise ValueError(f"initial is {self.initial}, opinions end at {self.opinions - 1}")

    def distance(self, opinion: int) -> float:
        """f: the distance in m for an opinion."""
        return self.base + self.step * opinion


class DiscussedDispersion(CombinedPattern[DiscussedDispersionParams]):
    """Votes on a distance at rest, then disperses to it and continues to vote.

    A later change of opinion changes the distance.
    """

    group = "spread"
    params_type = DiscussedDispersionParams
    report_units = {"distance": "m"}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: DiscussedDispersionParams, context: Context) -> None:
        _check(params, context.platform)
        super().__init__(params, context)
        self._started_at: float | None = None
        self._distance = float(self.parts[_MOVE].params.distance)

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        """The vote, shared with all robots that run majority_rule, and the motion."""
        make = self.context.make
        return {
            _VOTE: make("majority_rule", part=_VOTE, **_chosen(self.params, _OF_VOTE)),
            _MOVE: make("dispersion", part=_MOVE, **_chosen(self.params, _OF_MOVE)),
        }

    def update(self, params: DiscussedDispersionParams) -> None:
        """Apply changed parameters; ConfigError if protection forbids a distance."""
        _check(params, self.context.platform)
        super().update(params)
        for name, keys in ((_VOTE, _OF_VOTE), (_MOVE, _OF_MOVE)):
            part = self.parts[name]
            part.update(msgspec.structs.replace(part.params, **_chosen(params, keys)))

    def step(self, inputs: Inputs) -> Outputs:
        """Vote; after the time to discuss, also move."""
        if self._started_at is None:
            self._started_at = inputs.now
        vote = self.step_part(_VOTE, inputs)
        opinion = int(vote.report["opinion"])
        self._keep(self.params.distance(opinion))
        report: dict[str, Scalar] = {"opinion": opinion, "distance": self._distance}
        if inputs.now - self._started_at < self.params.discuss - 1e-9:
            return Outputs(messages=vote.messages, report={**report, "phase": "discuss"})
        move = self.step_part(_MOVE, inputs)
        report |= {"phase": "disperse", **move.report}
        return Outputs(move.twist, {**vote.messages, **move.messages}, report)

    def _keep(self, distance: float) -> None:
        if distance != self._distance:
            part = self.parts[_MOVE]
            part.update(msgspec.structs.replace(part.params, distance=distance))
            self._distance = distance


def _chosen(params: DiscussedDispersionParams, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: getattr(params, name) for name in names}


def _check(params: DiscussedDispersionParams, platform: Platform) -> None:
    least = threshold(platform)
    for opinion in range(params.opinions):
        distance = params.distance(opinion)
        if not least < distance <= 100.0:
            raise ConfigError(
                f"parameters base and step: opinion {opinion} means {distance:g} m; expected more"
                f" than {least:g} m, which the protection of {platform.name} keeps, and at most"
                " 100 m"
            )
