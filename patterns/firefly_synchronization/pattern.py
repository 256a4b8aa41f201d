"""Firefly synchronisation: the robots flash at the same time, and name robots that went silent.

Source: Mirollo and Strogatz, "Synchronization of pulse-coupled biological oscillators", SIAM J.
Applied Mathematics 50(6), 1990: a phase rises from 0 to 1, where the robot flashes. A flash of
another robot makes the phase jump ahead; the jump grows with the phase. After its flash a robot
ignores flashes for the refractory share of the period. Otherwise delayed messages would cause
echoes without end (Mathar and Mattfeldt, SIAM J. Applied Mathematics 56, 1996). Silent robots:
Christensen, O'Grady and Dorigo, "From fireflies to fault-tolerant swarms of robots", IEEE Trans.
Evolutionary Computation 13(4), 2009.

Ours: a message holds the time since the flash, and is repeated. So neither the rate of the steps
nor a lost message shifts a phase. The delay of a message by radio does shift a phase.
"""

from __future__ import annotations

import math
from typing import Annotated

from swarmd.api import (
    Context,
    Inputs,
    Message,
    Outputs,
    Params,
    Pattern,
    Recovery,
    Scalar,
    Value,
    about,
)

_CHANNEL = "flash"
# Flashes are numbered modulo this.
_FLASHES = 1 << 16
# Characters of the report's list of silent robots; a status takes 256.
_MAX_NAMES = 200


class FireflySynchronizationParams(Params, frozen=True, kw_only=True):
    """The oscillator and what counts as silent."""

    period: Annotated[
        float,
        about("time between two flashes alone", ge=0.5, le=600.0, unit="s", source="ours"),
    ] = 2.0
    coupling: Annotated[
        float,
        about(
            "rise of the state at a flash of another; 0: no coupling",
            ge=0.0,
            le=1.0,
            source="Mirollo and Strogatz 1990, epsilon; the value: ours",
        ),
    ] = 0.1
    concavity: Annotated[
        float,
        about(
            "how concave the state rises with the phase",
            ge=0.1,
            le=10.0,
            source="Mirollo and Strogatz 1990, b; the value: ours",
        ),
    ] = 3.0
    refractory: Annotated[
        float,
        about(
            "share of the period after a flash in which flashes of others count for nothing",
            ge=0.0,
            le=0.9,
            source="Mathar and Mattfeldt 1996; the value: ours, above twice the latency",
        ),
    ] = 0.25
    repeats: Annotated[
        int,
        about(
            "messages for each flash, one a step",
            ge=1,
            le=20,
            unit="messages",
            source="ours: at a loss of a tenth, a flash in 100 million is not heard",
        ),
    ] = 8
    silent_after: Annotated[
        float,
        about(
            "periods without a flash after which a robot is named as silent",
            ge=1.1,
            le=100.0,
            unit="periods",
            source="ours; Christensen et al. 2009: one missed flash",
        ),
    ] = 1.5
    recovery: Recovery = False


class FireflySynchronization(Pattern[FireflySynchronizationParams]):
    """Flashes in step with the neighbours, and names those that no longer flash; it stands."""

    group = "decide"
    params_type = FireflySynchronizationParams
    needs = frozenset[str]()
    channels = {_CHANNEL: list}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: FireflySynchronizationParams, context: Context) -> None:
        super().__init__(params, context)
        self._flashed_at: float | None = None
        self._flashes = 0
        self._left = 0
        self._sent_at = 0.0  # of the flash that is repeated; a jump moves only `_flashed_at`
        self._known: dict[str, tuple[int, float]] = {}  # number and time of the last flash

    def step(self, inputs: Inputs) -> Outputs:
        """Take in the flashes of others, flash when the phase is 1, and repeat the last flash."""
        now = inputs.now
        period = self.params.period
        if self._flashed_at is None:
            self._flashed_at = now - float(self.context.rng.random()) * period
        for message in inputs.messages:
            self._hear(message, now)
        if now - self._flashed_at >= period:
            periods = math.floor((now - self._flashed_at) / period)
            self._flash(self._flashed_at + periods * period)
        messages: dict[str, Value] = {}
        if self._left > 0:
            self._left -= 1
            messages[_CHANNEL] = [self._flashes, now - self._sent_at]
        limit = now - self.params.silent_after * period
        silent = sorted(name for name, (_, at) in self._known.items() if at < limit)
        report: dict[str, Scalar] = {
            "phase": (now - self._flashed_at) / period,
            "flashes": self._flashes,
            "silent": ",".join(silent)[:_MAX_NAMES],
        }
        return Outputs(messages=messages, report=report)

    def _hear(self, message: Message, now: float) -> None:
        """Make the phase jump ahead at a flash of another robot; repeated messages do not count."""
        flash = _read(message)
        if flash is None or message.sender == self.context.robot or self._flashed_at is None:
            return
        number, since = flash
        at = now - message.age - since
        known = self._known.get(message.sender)
        if known is not None and (known[0] == number or at < known[1]):
            return
        self._known[message.sender] = number, at
        phase = (at - self._flashed_at) / self.params.period
        if phase < self.params.refractory:
            return
        # The state of Mirollo and Strogatz is a concave function of the phase, and rises by
        # `coupling` at a flash. Their equation for the phase after that is linear.
        rise = math.exp(self.params.concavity * self.params.coupling)
        ahead = rise * phase + (rise - 1.0) / math.expm1(self.params.concavity)
        if ahead >= 1.0:
            self._flash(at)
        else:
            self._flashed_at -= (ahead - phase) * self.params.period

    def _flash(self, at: float) -> None:
        self._flashed_at = at
        self._sent_at = at
        self._flashes = (self._flashes + 1) % _FLASHES
        self._left = self.params.repeats


def _read(message: Message) -> tuple[int, float] | None:
    """The number and age in s of a flash; None for anything else."""
    value = message.value
    if message.channel != _CHANNEL or not isinstance(value, list) or len(value) != 2:
        return None
    number, since = value
    if not isinstance(number, int) or not isinstance(since, float | int):
        return None
    return (number, float(since)) if 0.0 <= since <= 60.0 else None
