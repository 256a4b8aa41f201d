"""A pattern that says 32 bytes at 10 Hz and does nothing else: the traffic of a talkative swarm."""

from __future__ import annotations

import math

from swarmd.api import Context, Inputs, Outputs, Params, Pattern

PERIOD = 0.1  # s


class ChatParams(Params, frozen=True):
    """None."""


class Chat(Pattern[ChatParams]):
    """Says a text of 32 bytes every `PERIOD`; a scan between two steps adds none.

    It reports how many robots and programs it has `heard`.
    """

    params_type = ChatParams
    channels = {"text": str}  # noqa: RUF012

    def __init__(self, params: ChatParams, context: Context) -> None:
        """Nothing said yet."""
        super().__init__(params, context)
        self._due = -math.inf
        self._senders: set[str] = set()

    def step(self, inputs: Inputs) -> Outputs:
        """A new text if one is due."""
        self._senders.update(message.sender for message in inputs.messages)
        report = {"heard": len(self._senders)}
        if inputs.now < self._due:
            return Outputs(report=report)
        self._due = max(self._due + PERIOD, inputs.now)
        return Outputs(messages={"text": f"{inputs.now:032.9f}"}, report=report)
