"""The base of patterns that are composed of other patterns."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import msgspec

from swarmd.core.values import Inputs, Message, Outputs, Scalar, Value
from swarmd.kit.behavior import Context, Pattern
from swarmd.kit.params import P


class CombinedPattern(Pattern[P]):
    """Steps its parts and combines their outputs; each part receives only its own channels.

    `needs` and `channels` of the object are those of the class and of all parts together. A
    channel of a part is named `<pattern>/<channel>` if it is shared with the stand-alone pattern,
    and `<part>-<channel>` if the part is private.
    """

    parts: Mapping[str, Pattern[Any]]

    def __init__(self, params: P, context: Context) -> None:
        super().__init__(params, context)
        self.parts = self.make_parts()
        self.needs = frozenset[str]().union(self.needs, *(p.needs for p in self.parts.values()))
        self.uses_places |= any(part.uses_places for part in self.parts.values())
        self.channels = dict(self.channels) | {
            outer_name(part, channel): kind
            for part in self.parts.values()
            for channel, kind in part.channels.items()
        }
        self._stepped_at: dict[str, float] = {}

    @abstractmethod
    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        """The parts by name, made with `self.context.make`."""

    def step(self, inputs: Inputs) -> Outputs:
        """Step all parts and combine."""
        return self.combine({name: self.step_part(name, inputs) for name in self.parts}, inputs)

    def combine(self, outputs: Mapping[str, Outputs], inputs: Inputs) -> Outputs:
        """Combine the outputs of all parts: the first command and grip, all messages and reports.

        Each value of a part's report gets the name `part.key`. The combined pattern is done once
        all parts are done. A pattern overrides this method for another combination.
        """
        twists = [part.twist for part in outputs.values() if part.twist is not None]
        reasons = [part.done for part in outputs.values() if part.done is not None]
        messages: dict[str, Value] = {}
        report: dict[str, Scalar] = {}
        for name, part in outputs.items():
            messages.update(part.messages)
            report.update({f"{name}.{key}": value for key, value in part.report.items()})
        done = "; ".join(reasons) if reasons and len(reasons) == len(outputs) else None
        grips = [part.grip for part in outputs.values() if part.grip is not None]
        grip = grips[0] if grips else None
        return Outputs(twists[0] if twists else None, messages, report, done, grip)

    def step_part(self, name: str, inputs: Inputs) -> Outputs:
        """Step one part with its own messages and dt; its outgoing messages get outer names."""
        part = self.parts[name]
        heard: tuple[Message, ...] = ()
        if inputs.messages:
            inner = {outer_name(part, channel): channel for channel in part.channels}
            heard = tuple(
                Message(m.sender, inner[m.channel], m.value, m.age)
                for m in inputs.messages
                if m.channel in inner
            )
        dt = inputs.now - self._stepped_at.get(name, inputs.now)
        self._stepped_at[name] = inputs.now
        outputs = part.step(msgspec.structs.replace(inputs, messages=heard, dt=dt))
        if not outputs.messages:
            return outputs
        messages = {outer_name(part, channel): value for channel, value in outputs.messages.items()}
        return msgspec.structs.replace(outputs, messages=messages)


def outer_name(part: Pattern[Any], channel: str) -> str:
    """The name that the outer pattern gives a channel of its part; shared names are unchanged."""
    return channel if "/" in channel else part.context.channel_prefix + channel
