"""Reads the samples of a step from the recordings of the robot."""

from __future__ import annotations

from collections.abc import Iterable

from swarmd.daemon.recording import messages
from swarmd.daemon.recording.inputs import InputReader, TimedInput
from swarmd.daemon.recording.reader import RecordedFile, clock_of
from swarmd.operator.acceptance.evidence import Samples, TimedDecision

_DECISION = "/decision"


def read_samples(files: Iterable[RecordedFile]) -> Samples:
    """The samples of recordings of one robot, in order.

    ConfigError or CodecError for a file that is damaged, or of another version.
    """
    inputs: list[TimedInput] = []
    decisions: list[TimedDecision] = []
    wall = 0.0
    for file in files:
        reader = InputReader()
        for message in file.messages:
            at = clock_of(file.about, message.at)
            wall = 1e-9 * message.at - at
            if (input := reader.read(message)) is not None:
                inputs.append(input)
            elif message.topic == _DECISION:
                decision = messages.message_on(_DECISION, message.kind, message.payload)
                safe = messages.twist_of(decision.safe)
                gap = float(decision.gap)
                share = float(decision.speed_share)
                decisions.append(TimedDecision(at, safe, gap, share))
    return Samples(inputs, decisions, wall)
