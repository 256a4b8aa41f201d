"""Trimmed consensus: the robots agree on a number although a few of them send false numbers.

Source: LeBlanc, Zhang, Koutsoukos and Sundaram, "Resilient asymptotic consensus in robust
networks", IEEE J. Selected Areas in Communications 31(4), 2013 (W-MSR). A robot drops the `trim`
largest of the neighbours' values above its own value, and the `trim` smallest of the values below.
The new value is the mean of the remaining values and its own value. The source proves that the
honest robots agree on a value between their first values, if each has at most `trim` neighbours
that lie, and if the network is (2 trim + 1)-robust. A complete network of more than 4 trim robots
is (2 trim + 1)-robust.

Ours: the values come in messages that may be late or lost; the last value of each neighbour counts.
`trim: 0` is plain averaging (Olfati-Saber and Murray 2004), in which one liar moves the swarm to
any value.
"""

from __future__ import annotations

import math
from typing import Annotated

from swarmd.api import (
    Context,
    Inputs,
    Lease,
    Message,
    Outputs,
    Params,
    Pattern,
    Recovery,
    about,
)

_CHANNEL = "value"
# Larger values are not believed: sums of them must be finite.
_MAX_VALUE = 1e9


class TrimmedConsensusParams(Params, frozen=True, kw_only=True):
    """The first value, the number of liars to stand, and the times."""

    initial: (
        Annotated[
            float,
            about("value at first; none: a random one in 0 to 1", ge=-1e9, le=1e9, source="ours"),
        ]
        | None
    ) = None
    trim: Annotated[
        int,
        about(
            "liars among the neighbours that it stands; 0: plain averaging",
            ge=0,
            le=1000,
            unit="robots",
            source="LeBlanc et al. 2013, F",
        ),
    ] = 1
    is_stubborn: Annotated[
        bool,
        about("keep the first value whatever the others say: a liar, for tests", source="ours"),
    ] = False
    update_period: Annotated[
        float,
        about(
            "time between two updates, each with a message",
            ge=0.1,
            le=600.0,
            unit="s",
            source="ours",
        ),
    ] = 0.5
    expiry: Lease = 3.0
    recovery: Recovery = False


class TrimmedConsensus(Pattern[TrimmedConsensusParams]):
    """Sends its value, moves the value to the trimmed mean of the neighbours', and stands."""

    group = "decide"
    params_type = TrimmedConsensusParams
    needs = frozenset[str]()
    channels = {_CHANNEL: float}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: TrimmedConsensusParams, context: Context) -> None:
        super().__init__(params, context)
        first = params.initial
        self.value = float(context.rng.random()) if first is None else float(first)
        self._heard: dict[str, tuple[float, float]] = {}  # value and time by neighbour
        self._update_at: float | None = None

    def step(self, inputs: Inputs) -> Outputs:
        """Take in values; update the own one and send it when both are due."""
        now = inputs.now
        for message in inputs.messages:
            self._hear(message, now - message.age)
        if self._update_at is None:
            # The first message comes before the first update, at a random time.
            self._update_at = now + float(self.context.rng.random()) * self.params.update_period
            return Outputs(messages={_CHANNEL: self.value}, report={"value": self.value})
        if now < self._update_at:
            return Outputs(report={"value": self.value})
        self._update_at = now + self.params.update_period
        oldest = now - self.params.expiry
        self._heard = {name: heard for name, heard in self._heard.items() if heard[1] >= oldest}
        if not self.params.is_stubborn:
            values = [value for value, _ in self._heard.values()]
            kept = trimmed(values, self.value, self.params.trim)
            self.value = math.fsum([*kept, self.value]) / (len(kept) + 1)
        return Outputs(messages={_CHANNEL: self.value}, report={"value": self.value})

    def _hear(self, message: Message, at: float) -> None:
        value = message.value
        if message.channel != _CHANNEL or not isinstance(value, float):
            return
        if abs(value) <= _MAX_VALUE and message.sender != self.context.robot:
            self._heard[message.sender] = value, at


def trimmed(values: list[float], own: float, trim: int) -> list[float]:
    """The values without the `trim` largest above `own` and the `trim` smallest below `own`."""
    below = sorted(value for value in values if value < own)
    above = sorted(value for value in values if value > own)
    equal = [value for value in values if value == own]
    return below[trim:] + equal + above[: max(len(above) - trim, 0)]
