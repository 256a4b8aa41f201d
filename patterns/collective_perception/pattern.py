"""Collective perception: the robots agree on which colour covers more of the floor.

Source: Valentini, Brambilla, Hamann and Dorigo, "Collective perception of environmental features in
a robot swarm", ANTS 2016: 20 e-pucks on 400 black and white tiles. A robot explores for a random
time and measures the quality of its opinion: the share of the time in which the floor has that
colour. Then the robot sends its opinion for a random time, and decides by the opinions heard last.
With the rules "voter" (DMVD) and "majority" (DMMD) the mean time of sending is proportional to the
quality. With rule "comparison" (DC) the robot sends its quality too, for a mean time that does not
depend on the quality.

Ours: the robots walk by the pattern random_walk.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from swarmd.api import (
    CombinedPattern,
    Context,
    Inputs,
    Message,
    Outputs,
    Params,
    Pattern,
    Recovery,
    Scalar,
    SharePeriod,
    TopSpeed,
    Value,
    WalkClearance,
    about,
    majority,
)

OPINION = "colour"
BLACK = 0
WHITE = 1
_WALK = "walk"


class CollectivePerceptionParams(Params, frozen=True, kw_only=True):
    """The rule, its times, the floor and the walk."""

    rule: Annotated[
        Literal["voter", "majority", "comparison"],
        about("how a robot decides by what it heard", source="Valentini et al. 2016"),
    ] = "majority"
    initial: (
        Annotated[
            int,
            about(
                "0: black, 1: white, to start with; none: a random one",
                ge=0,
                le=1,
                source="Valentini et al. 2016: half of the robots each",
            ),
        ]
        | None
    ) = None
    explore: Annotated[
        float,
        about(
            "mean time for which a robot measures the floor",
            ge=0.1,
            le=3600.0,
            unit="s",
            source="Valentini et al. 2016",
        ),
    ] = 10.0
    tell: Annotated[
        float,
        about(
            "mean time for which a robot tells its opinion, at quality 1",
            ge=0.1,
            le=3600.0,
            unit="s",
            source="Valentini et al. 2016",
        ),
    ] = 10.0
    listen: Annotated[
        float,
        about(
            "opinions heard in that time before the decision count",
            ge=0.1,
            le=600.0,
            unit="s",
            source="Valentini et al. 2016",
        ),
    ] = 3.0
    share_period: SharePeriod = 0.5
    black: Annotated[
        float,
        about("the floor is black below", ge=0.0, le=1e6, source="ours: halfway to white"),
    ] = 0.5
    speed: TopSpeed
    clearance: WalkClearance
    recovery: Recovery = False


class CollectivePerception(CombinedPattern[CollectivePerceptionParams]):
    """Walks, measures the floor, tells its opinion and decides, in turns."""

    group = "decide"
    params_type = CollectivePerceptionParams
    needs = frozenset({"scan", "reading:ground"})
    channels = {OPINION: list}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: CollectivePerceptionParams, context: Context) -> None:
        super().__init__(params, context)
        first = params.initial
        self.opinion = int(context.rng.integers(2)) if first is None else first
        self.quality = 1.0
        self._is_exploring = False
        self._phase_end = 0.0
        self._tell_at = 0.0
        self._has_begun = False
        self._measured_s = 0.0  # time of this exploration
        self._matched_s = 0.0  # of this time: on a floor of the opinion's colour
        self._heard: dict[str, tuple[float, int, float]] = {}  # time, opinion and quality

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        """The walk."""
        speed = self.params.speed
        clearance = self.params.clearance
        walk = self.context.make("random_walk", part=_WALK, speed=speed, clearance=clearance)
        return {_WALK: walk}

    def step(self, inputs: Inputs) -> Outputs:
        """Walk; measure the floor and send the opinion by turns, and decide after each sending.

        The quality is the share of the measured time in which the floor had the opinion's colour.
        Without a scan or a reading of the floor: no command, and only the opinion in the report.
        """
        for message in inputs.messages:
            self._hear(message, inputs.now)
        if inputs.scan is None or "ground" not in inputs.readings:
            return Outputs(report={"opinion": self.opinion})
        # 1. The next phase, if this phase is over. `_explore` and `_tell` draw its random duration.
        if not self._has_begun:
            self._has_begun = True
            self._explore(inputs.now)
        elif inputs.now >= self._phase_end:
            if self._is_exploring:
                self._tell(inputs.now)
            else:
                self._decide(inputs.now)
                self._explore(inputs.now)
        # 2. Measure, or send the opinion and its quality every `share_period`.
        messages: dict[str, Value] = {}
        if self._is_exploring:
            colour = BLACK if inputs.readings["ground"] < self.params.black else WHITE
            self._measured_s += inputs.dt
            if colour == self.opinion:
                self._matched_s += inputs.dt
        elif inputs.now >= self._tell_at:
            messages[OPINION] = [self.opinion, self.quality]
            self._tell_at = inputs.now + self.params.share_period
        report: dict[str, Scalar] = {
            "opinion": self.opinion,
            "quality": round(self.quality, 3),
            "phase": "explore" if self._is_exploring else "tell",
        }
        return Outputs(self.step_part(_WALK, inputs).twist, messages, report)

    def _explore(self, now: float) -> None:
        self._is_exploring = True
        self._measured_s = 0.0
        self._matched_s = 0.0
        self._phase_end = now + float(self.context.rng.exponential(self.params.explore))

    def _tell(self, now: float) -> None:
        self._is_exploring = False
        self._tell_at = now
        self.quality = self._matched_s / self._measured_s if self._measured_s > 0.0 else 0.0
        weight = 1.0 if self.params.rule == "comparison" else self.quality
        self._phase_end = now + float(self.context.rng.exponential(self.params.tell * weight))

    def _decide(self, now: float) -> None:
        """Adopt an opinion by the rule; the own one stays if nothing was heard."""
        since = now - self.params.listen
        heard = {robot: told for robot, told in self._heard.items() if told[0] >= since}
        self._heard = {}
        if not heard:
            return
        rng = self.context.rng
        if self.params.rule == "majority":
            votes = [self.opinion, *(opinion for _, opinion, _ in heard.values())]
            self.opinion = majority(votes, self.opinion, ties="keep", rng=rng)
            return
        _, opinion, quality = list(heard.values())[int(rng.integers(len(heard)))]
        if self.params.rule == "voter" or quality > self.quality:
            self.opinion = opinion

    def _hear(self, message: Message, now: float) -> None:
        """Keep the latest opinion of a robot; anything else in a message is ignored."""
        match (message.channel == OPINION) and message.value:
            case [int(opinion), float(quality)] if opinion in (BLACK, WHITE):
                if 0.0 <= quality <= 1.0:
                    self._heard[message.sender] = (now - message.age, int(opinion), quality)
