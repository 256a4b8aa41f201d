"""The base of voting patterns: collects votes and sends the opinion. A pattern only decides."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, ClassVar, TypeVar

from swarmd.core.values import OPINION, ROUND_VOTE, Inputs, Message, Neighbor, Outputs, Value
from swarmd.kit.behavior import Context, Pattern
from swarmd.kit.params import Params, Recovery, about
from swarmd.kit.vote_windows import Rounds, Ties, VoteWindow, Windows, read_opinion, read_round_vote

Opinions = Annotated[
    int,
    about("number of opinions; they are 0, 1, 2 ...", ge=1, le=1000, source="paper, experiment 2"),
]
Initial = Annotated[
    int, about("opinion to start with; none: a random one", ge=0, le=999, source="paper")
]
WindowLength = Annotated[
    float, about("length of the voting window", ge=0.1, le=600.0, unit="s", source="ROS2swarm")
]
TieRule = Annotated[
    Ties,
    about(
        "between equal counts: a random one of them, keep the own opinion, or the lowest",
        source="ROS2swarm",
    ),
]


class VotingParams(Params, frozen=True, kw_only=True):
    """The parameters of every voting pattern."""

    opinions: Opinions = 3
    initial: Initial | None = None
    windows: Annotated[
        Windows,
        about(
            "tumbling: one window after the other; sliding: the last `window` s, every "
            "share_period; rounds: all robots together, once all have voted or `window` s passed",
            source="paper: tumbling, the others as variants",
        ),
    ] = "tumbling"
    window: WindowLength = 5.0
    share_period: Annotated[
        float,
        about(
            "time between two messages with the own opinion; at most half a window",
            ge=0.1,
            le=600.0,
            unit="s",
            source="ours: a lost message, or one that arrives after the window, costs no vote",
        ),
    ] = 1.0
    expiry: Annotated[
        float,
        about(
            "a vote that is older does not count",
            ge=0.1,
            le=600.0,
            unit="s",
            source="ours: a robot that has left must not vote",
        ),
    ] = 3.0
    count_own: Annotated[
        bool, about("count the own opinion as a vote", source="ROS2swarm: it is not")
    ] = False
    staggered: Annotated[
        bool,
        about(
            "end the first window after a random share of its length; no effect with rounds",
            source="ROS2swarm: its timers start at different times. In step, two halves of "
            "different opinion swap opinions for ever",
        ),
    ] = True
    recovery: Recovery = False

    @property
    def period(self) -> float:
        """Seconds between two messages with the own opinion."""
        return min(self.share_period, 0.5 * self.window)

    def __post_init__(self) -> None:
        """Check what bounds of single fields cannot."""
        if self.initial is not None and self.initial >= self.opinions:
            raise ValueError(f"initial is {self.initial}, opinions end at {self.opinions - 1}")
        if self.expiry < self.period:
            raise ValueError(f"expiry is {self.expiry:g} s, less than share_period")


V = TypeVar("V", bound=VotingParams)


class VotingPattern(Pattern[V]):
    """Holds an opinion, sends it to the neighbours, and updates it at the end of each window.

    A window is a time in which votes are counted (`vote_windows.py`). The robot stands. Source:
    Kaiser et al., ICRA 2022: each robot sends its opinion after every update. Ours: the robot also
    repeats its opinion. A vote expires if it is not repeated, or if its sender is no longer a
    neighbour.
    """

    params_type: ClassVar[type[Params]] = VotingParams
    needs = frozenset[str]()
    channels = {OPINION: int, ROUND_VOTE: list}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: V, context: Context) -> None:
        super().__init__(params, context)
        initial = params.initial
        self.opinion = int(context.rng.integers(params.opinions)) if initial is None else initial
        self._previous = self.opinion
        self._window: VoteWindow | Rounds | None = None
        self._neighbors: tuple[Neighbor, ...] = ()
        self._share_at = 0.0
        self._heard = 0

    @abstractmethod
    def decide(self, votes: Mapping[str, int]) -> int:
        """The new opinion after a window. `votes`: the latest vote of each neighbour, by robot.

        `votes` has at least one vote. With `count_own` the robot's own vote is among them.
        """

    def step(self, inputs: Inputs) -> Outputs:
        """Count received votes, decide when a window ends, and send the opinion when it is due."""
        if self._window is None:
            self._window = self._open(inputs.now)
            self._share_at = inputs.now
        window = self._window
        for message in inputs.messages:
            if message.sender != self.context.robot:
                self._take(window, message, inputs.now - message.age)
        self._forget_gone(window, inputs.neighbors)
        votes = window.close(inputs.now)
        if votes is not None:
            self._conclude({s: o for s, o in votes.items() if o < self.params.opinions})
            self._share_at = inputs.now
        report = {"opinion": self.opinion, "heard": self._heard}
        if isinstance(window, Rounds):
            report["round"] = window.round
        return Outputs(messages=self._share(window, inputs.now), report=report)

    def update(self, params: V) -> None:
        """Apply changed parameters; an opinion that no longer exists is drawn again at random.

        A changed length applies from the next window on; a change of `windows` opens a new window
        at once.
        """
        if params.windows != self.params.windows:
            self._window = None
        super().update(params)
        if self._window is not None:
            self._window.length = params.window
            self._window.expiry = params.expiry
            if self._window.period is not None:
                self._window.period = params.period
        if self.opinion >= params.opinions:
            self.opinion = int(self.context.rng.integers(params.opinions))
            self._share_at = 0.0  # send it at the next step
        # The opinion of the round before, which a message also holds, must exist, too.
        self._previous = min(self._previous, params.opinions - 1)

    def _open(self, now: float) -> VoteWindow | Rounds:
        params = self.params
        length = params.window
        period = params.period
        expiry = params.expiry
        if params.windows == "rounds":
            return Rounds(length, period, now=now, expiry=expiry)
        first = 1.0 - float(self.context.rng.random()) if params.staggered else 1.0
        every = period if params.windows == "sliding" else None
        return VoteWindow(length, now=now, period=every, expiry=expiry, first=first)

    def _take(self, window: VoteWindow | Rounds, message: Message, received_at: float) -> None:
        """Count the vote in a message; anything else in it is ignored."""
        count = self.params.opinions
        if message.channel == OPINION:
            opinion = read_opinion(message.value, count)
            if opinion is not None:
                window.add(message.sender, opinion, received_at)
        elif message.channel == ROUND_VOTE:
            vote = read_round_vote(message.value, count)
            if vote is not None:
                window.add_round_vote(message.sender, vote, received_at)

    def _forget_gone(self, window: VoteWindow | Rounds, neighbors: tuple[Neighbor, ...]) -> None:
        """Drop the votes of robots that are no longer neighbours."""
        if neighbors is self._neighbors:
            return
        here = {neighbor.id for neighbor in neighbors}
        for neighbor in self._neighbors:
            if neighbor.id not in here:
                window.forget(neighbor.id)
        self._neighbors = neighbors

    def _conclude(self, votes: dict[str, int]) -> None:
        """Set the opinion by the votes of a window that has ended."""
        self._previous = self.opinion
        self._heard = len(votes)
        if not votes:
            return
        if self.params.count_own:
            votes[self.context.robot] = self.opinion
        self.opinion = self.decide(votes)

    def _share(self, window: VoteWindow | Rounds, now: float) -> Mapping[str, Value]:
        """The message with the own opinion, if one is due."""
        if now < self._share_at:
            return {}
        self._share_at = now + self.params.period
        if isinstance(window, Rounds):
            return {ROUND_VOTE: [window.round, self.opinion, self._previous]}
        return {OPINION: self.opinion}
