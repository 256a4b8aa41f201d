"""The base of voting patterns: it owns windows, expiry and sharing; a pattern only decides."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, ClassVar, TypeVar

from swarmd.behavior import Context, Pattern
from swarmd.params import Params, Unstick, about
from swarmd.values import Inputs, Outputs
from swarmd.votes import VoteWindow, read_opinion

OPINION = "opinion"


class VotingParams(Params, frozen=True, kw_only=True):
    """What every voting pattern can be told."""

    opinions: Annotated[
        int,
        about(
            "number of opinions; they are 0, 1, 2 ...", ge=1, le=1000, source="paper, experiment 2"
        ),
    ] = 3
    initial: (
        Annotated[
            int,
            about("opinion to start with; none: a random one", ge=0, le=999, source="paper"),
        ]
        | None
    ) = None
    window: Annotated[
        float,
        about("length of the voting window", ge=0.1, le=600.0, unit="s", source="ROS2swarm"),
    ] = 5.0
    share_period: Annotated[
        float,
        about(
            "time between two repetitions of the own opinion; at most half a window",
            ge=0.1,
            le=600.0,
            unit="s",
            source="ours: a lost message, or one that crosses the end of a window, costs no vote",
        ),
    ] = 1.0
    expiry: Annotated[
        float,
        about(
            "a vote not repeated for so long does not count",
            ge=0.1,
            le=600.0,
            unit="s",
            source="ours: a robot that has gone must not vote",
        ),
    ] = 3.0
    unstick: Unstick = False

    def __post_init__(self) -> None:
        """Check what bounds of single fields cannot."""
        if self.initial is not None and self.initial >= self.opinions:
            raise ValueError(f"initial is {self.initial}, opinions end at {self.opinions - 1}")
        if self.expiry < min(self.share_period, 0.5 * self.window):
            raise ValueError(f"expiry is {self.expiry:g} s, less than share_period")


V = TypeVar("V", bound=VotingParams)


class VotingPattern(Pattern[V]):
    """Holds an opinion, tells it to the neighbours and changes its mind at the end of a window.

    The robot stands. Source: Kaiser et al., ICRA 2022: each robot shares its opinion after every
    update. Ours: it also repeats it, and votes that are not repeated expire.
    """

    params_type: ClassVar[type[Params]] = VotingParams
    needs = frozenset[str]()
    channels = {OPINION: int}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: V, context: Context) -> None:
        super().__init__(params, context)
        initial = params.initial
        self.opinion = int(context.rng.integers(params.opinions)) if initial is None else initial
        self._window: VoteWindow | None = None
        self._share_at = 0.0
        self._heard = 0

    @abstractmethod
    def decide(self, heard: Mapping[str, int]) -> int:
        """The new opinion from the latest one of each neighbour in the window; never empty."""

    def step(self, inputs: Inputs) -> Outputs:
        """Count what was heard; at the end of a window decide; share when it is time."""
        if self._window is None:
            self._window = self._open(inputs.now)
            self._share_at = inputs.now
        for message in inputs.messages:
            vote = read_opinion(message.value, self.params.opinions)
            is_other = message.channel == OPINION and message.sender != self.context.robot
            if vote is not None and is_other:
                self._window.add(message.sender, vote, inputs.now - message.age)
        heard = self._window.close(inputs.now)
        if heard is not None:
            self._heard = len(heard)
            self.opinion = self.decide(heard) if heard else self.opinion
            self._share_at = inputs.now
        report = {"opinion": self.opinion, "heard": self._heard}
        return Outputs(messages=self._share(inputs.now), report=report)

    def update(self, params: V) -> None:
        """Take over changed parameters; an opinion that no longer exists is drawn anew."""
        super().update(params)
        if self._window is not None:
            self._window.length, self._window.expiry = params.window, params.expiry
        if self.opinion >= params.opinions:
            self.opinion = int(self.context.rng.integers(params.opinions))
            self._share_at = 0.0

    def _open(self, now: float) -> VoteWindow:
        return VoteWindow(self.params.window, now=now, expiry=self.params.expiry)

    def _share(self, now: float) -> Mapping[str, int]:
        if now < self._share_at:
            return {}
        self._share_at = now + min(self.params.share_period, 0.5 * self.params.window)
        return {OPINION: self.opinion}
