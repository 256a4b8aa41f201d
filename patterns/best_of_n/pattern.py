"""Best of n: the robots agree on the best option; better options are promoted longer.

Source: Valentini, Hamann and Dorigo, "Self-organized collective decision making: the weighted voter
model", AAMAS 2014; Valentini, Ferrante, Hamann and Dorigo, "Collective decision with 100 Kilobots:
speed versus accuracy in binary discrimination problems", Autonomous Agents and Multi-Agent Systems
30, 2016. A robot explores its option for a random time of mean sigma, and measures the quality.
Then the robot sends its opinion for a random time of mean g times the quality. So more robots hear
of better options. At the end the robot decides by the neighbours heard last: it adopts the majority
opinion of them and itself, or the opinion of a random neighbour (the weighted voter model).

Ours: a driver gives the quality of option k, from 0 to 1, as the reading `quality_k`. The robot
stands: exploration is a time here, not a walk. A mission may combine the pattern with a walk, since
a robot that meets the same neighbours again hears the same opinions again.
"""

from __future__ import annotations

from typing import Annotated, Literal

from swarmd.api import (
    ConfigError,
    Context,
    Initial,
    Inputs,
    Message,
    Outputs,
    Params,
    Pattern,
    Recovery,
    SharePeriod,
    about,
    majority,
)

_CHANNEL = "opinion"


class BestOfNParams(Params, frozen=True, kw_only=True):
    """The rule, the options and the times."""

    rule: Annotated[
        Literal["majority", "voter"],
        about(
            "majority: of the last neighbours heard and itself; voter: a random one of them",
            source="Valentini et al. 2016 and 2014; majority is faster",
        ),
    ] = "majority"
    options: Annotated[
        int,
        about("number of options; they are 0, 1 ...", ge=2, le=9, unit="options", source="ours"),
    ] = 2
    initial: Initial | None = None
    exploration: Annotated[
        float,
        about(
            "mean time between two promotions, in which the quality is measured",
            ge=0.1,
            le=36000.0,
            unit="s",
            source="Valentini et al. 2016, sigma: 6.072 min; a sixtieth of it",
        ),
    ] = 6.072
    dissemination: Annotated[
        float,
        about(
            "mean time for which an option of quality 1 is promoted",
            ge=0.1,
            le=36000.0,
            unit="s",
            source="Valentini et al. 2016, g: 8.4 min; a sixtieth of it",
        ),
    ] = 8.4
    group: Annotated[
        int,
        about(
            "greatest number of neighbours, the last heard, that are counted",
            ge=1,
            le=1000,
            unit="robots",
            source="Valentini et al. 2016, G_max: 5 and 25",
        ),
    ] = 5
    memory: Annotated[
        float,
        about(
            "time before the end of a promotion in which opinions are heard",
            ge=0.1,
            le=36000.0,
            unit="s",
            source="Valentini et al. 2016: 3 min; a sixtieth of it",
        ),
    ] = 3.0
    share_period: SharePeriod = 0.5
    recovery: Recovery = False

    def __post_init__(self) -> None:
        """Check that the initial opinion is an option."""
        if self.initial is not None and self.initial >= self.options:
            raise ValueError(f"initial is {self.initial}, options end at {self.options - 1}")


class BestOfN(Pattern[BestOfNParams]):
    """Explores, promotes its opinion for a time by its quality, and decides; it stands."""

    group = "decide"
    params_type = BestOfNParams
    needs = frozenset({"reading:quality_0", "reading:quality_1"})
    channels = {_CHANNEL: int}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: BestOfNParams, context: Context) -> None:
        super().__init__(params, context)
        self._check(params)
        first = params.initial
        self.opinion = int(context.rng.integers(params.options)) if first is None else int(first)
        self._promotes = False
        self._until: float | None = None
        self._share_at = 0.0
        self._heard: dict[str, tuple[float, int]] = {}  # time and opinion by neighbour

    def update(self, params: BestOfNParams) -> None:
        """Apply changed parameters; an opinion that no longer exists is drawn again."""
        self._check(params)
        super().update(params)
        self._heard = {}  # maybe of options that are no more
        if self.opinion >= params.options:
            self.opinion = int(self.context.rng.integers(params.options))

    def step(self, inputs: Inputs) -> Outputs:
        """Take in opinions while it promotes; change the state when its time is over."""
        now = inputs.now
        params = self.params
        for message in inputs.messages:
            self._hear(message, now - message.age)
        if self._until is None:
            self._until = now + self._random(params.exploration)
        if now >= self._until:
            if self._promotes:
                self._decide(now)
                self._until = now + self._random(params.exploration)
            else:
                quality = min(max(inputs.readings.get(f"quality_{self.opinion}", 0.0), 0.0), 1.0)
                self._until = now + self._random(params.dissemination * quality)
            self._promotes = not self._promotes
        report = {"opinion": self.opinion, "promotes": self._promotes}
        # A promotion of no quality ends as it begins.
        if not self._promotes or not self._share_at <= now < self._until:
            return Outputs(report=report)
        self._share_at = now + params.share_period
        return Outputs(messages={_CHANNEL: self.opinion}, report=report)

    def _check(self, params: BestOfNParams) -> None:
        """ConfigError if the platform has no reading of the quality of an option."""
        needs = frozenset(f"reading:quality_{option}" for option in range(params.options))
        missing = sorted(needs - self.context.platform.provides)
        if missing:
            raise ConfigError(f"options is {params.options}, which needs {', '.join(missing)}")

    def _random(self, mean: float) -> float:
        return float(self.context.rng.exponential(mean))

    def _hear(self, message: Message, at: float) -> None:
        value = message.value
        if message.channel != _CHANNEL or message.sender == self.context.robot:
            return
        if isinstance(value, int) and 0 <= value < self.params.options:
            self._heard[message.sender] = at, value

    def _decide(self, now: float) -> None:
        """Adopt an opinion of those heard last; without any it keeps its own."""
        since = now - self.params.memory
        recent = sorted(heard for heard in self._heard.values() if heard[0] >= since)
        votes = [opinion for _, opinion in recent[-self.params.group :]]
        self._heard = {}
        if not votes:
            return
        rng = self.context.rng
        if self.params.rule == "voter":
            self.opinion = votes[int(rng.integers(len(votes)))]
        else:
            self.opinion = majority([*votes, self.opinion], self.opinion, ties="keep", rng=rng)
