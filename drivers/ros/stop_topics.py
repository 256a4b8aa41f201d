"""The topics on which any ROS node stops this robot, `swarmd/stop` and `swarmd/estop`. Pure.

The topic `swarmd/state` has the answer to each stop. ROS authenticates no node: in a swarm without
keys each node on the robot's ROS graph may stop it, and in a swarm with keys the option
`stop_operator` names the operator that counts as the sender of each stop.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, Literal

from swarmd.core.errors import CodecError
from swarmd.core.finding import Finding
from swarmd.core.messages import Reply
from swarmd.core.token_bucket import TokenBucket
from swarmd.driver_api.command_source import DriverCommand, TakeCommand
from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.messages import Empty, String
from swarmd.drivers.ros.options import TopicOptions

CALL_RATE, CALL_BURST = 10.0, 10.0
"""Stops per second of one topic, or calls of one service, and at once; others are dropped."""
MAX_REASON = 200
"""Characters of the reason of an emergency stop."""
STATE = "swarmd/state"
UNNAMED = "ROS"
"""The operator without an option. A roster has no name with capitals, so its swarm refuses it."""

_VERBS: Mapping[Literal["stop", "estop"], type] = {"stop": Empty, "estop": String}


class StopTopics:
    """Makes a command of each message; `serve` sets what takes it.

    `topics`: the message type of each topic by its full name. A message stops the robot whatever
    its bytes are; with bytes that are no text, an emergency stop has no reason.
    """

    def __init__(
        self, options: TopicOptions, show: Callable[[str], None], operator: str = ""
    ) -> None:
        """`show` publishes a text on `state_topic`. `operator`: without option `stop_operator`."""
        self._show, self._is_named = show, options.stop_operator is not None
        self.state_topic = options.topic(STATE)
        self.topics = {options.topic(f"swarmd/{verb}"): kind for verb, kind in _VERBS.items()}
        self._stops = {
            topic: DriverCommand(
                verb=verb,
                operator=options.stop_operator or operator or UNNAMED,
                source=f"ROS topic {topic}",
            )
            for topic, verb in zip(self.topics, _VERBS, strict=True)
        }
        self._stop_limits = {topic: TokenBucket(CALL_RATE, CALL_BURST) for topic in self.topics}
        self._take: TakeCommand | None = None

    @property
    def runs(self) -> Mapping[str, DriverCommand]:
        """A stop by the operator that the option names, by the key of the option."""
        return {"stop_operator": next(iter(self._stops.values()))} if self._is_named else {}

    def serve(self, take: TakeCommand) -> None:
        """Hand the commands to `take`; without it messages and calls do nothing."""
        self._take = take

    def findings(self) -> tuple[Finding, ...]:
        """The finding of `swarmd --check`."""
        topics = (
            f"{topic} ({name_of(kind).replace('/msg/', '/')})"
            for topic, kind in self.topics.items()
        )
        operator = next(iter(self._stops.values())).operator
        return (Finding("stop topics", True, f"hears {' and '.join(topics)} as {operator}"),)

    def hear(
        self, topic: str, payload: bytes, decode: Callable[[type[Any], bytes], Any], now: float
    ) -> bool:
        """Take a message at `now` s; False if nothing takes it, or too many came before it."""
        if self._take is None or not self._stop_limits[topic].take(1.0, now):
            return False
        text = ""
        with suppress(CodecError):
            text = decode(String, payload).data[:MAX_REASON]
        reason = "".join(char if char.isprintable() else " " for char in text)
        self._take(replace(self._stops[topic], reason=reason), self._on_reply)
        return True

    def _on_reply(self, reply: Reply) -> None:
        self._show(reply.text)
