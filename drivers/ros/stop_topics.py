"""The topics on which any ROS node stops this robot, `swarmd/stop` and `swarmd/estop`. Pure.

The topic `swarmd/state` has the answer to each stop. ROS authenticates no node: in a swarm without
keys each node on the robot's ROS graph may stop it, and in a swarm with keys the option
`stop_operator` names the operator that counts as the sender of each stop.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from swarmd.core.errors import CodecError
from swarmd.core.token_bucket import TokenBucket
from swarmd.driver_api.command_source import DriverCommand, TakeCommand
from swarmd.drivers.ros.messages import Empty, String
from swarmd.drivers.ros.options import TopicOptions

CALL_RATE = 10.0
CALL_BURST = 10.0
"""Stops per second of one topic, or calls of one service, and at once; others are dropped."""
MAX_REASON = 200
"""Characters of the reason of an emergency stop."""
UNNAMED = "ROS"
"""The operator without an option. A roster has no name with capitals, so its swarm refuses it."""
STOP_TYPES: Mapping[str, type] = {"stop": Empty, "estop": String}
"""The type of the messages by verb."""


class StopTopics:
    """Makes a command of each message; `serve` sets what takes it.

    `topics`: the command of each topic by its full name. A message stops the robot whatever its
    bytes are; with bytes that are no text, an emergency stop has no reason.
    """

    def __init__(
        self, options: TopicOptions, show: Callable[[str], None], operator: str = ""
    ) -> None:
        """`show` publishes a text on `state_topic`. `operator`: without option `stop_operator`."""
        self._show = show
        self.state_topic = options.topic("swarmd/state")
        self.topics = {
            (topic := options.topic(f"swarmd/{verb}")): DriverCommand(
                verb=verb,  # type: ignore[arg-type]  # both are literals of its type
                operator=options.stop_operator or operator or UNNAMED,
                source=f"ROS topic {topic}",
            )
            for verb in STOP_TYPES
        }
        self._stop_limits = {topic: TokenBucket(CALL_RATE, CALL_BURST) for topic in self.topics}
        self._take: TakeCommand | None = None

    @property
    def runs(self) -> Mapping[str, DriverCommand]:
        """The stops by an operator that the options name, by topic."""
        return {name: one for name, one in self.topics.items() if one.operator != UNNAMED}

    def serve(self, take: TakeCommand) -> None:
        """Hand the commands to `take`; without it messages and calls do nothing."""
        self._take = take

    def hear(
        self, topic: str, payload: bytes, decode: Callable[[type[Any], bytes], Any], now: float
    ) -> bool:
        """Take a message at `now` s; False if nothing takes it, or too many came before it."""
        if self._take is None or not self._stop_limits[topic].take(1.0, now):
            return False
        reason = ""
        with suppress(CodecError):
            reason = "".join(
                char if char.isprintable() else " "
                for char in decode(String, payload).data[:MAX_REASON]
            )
        self._take(replace(self.topics[topic], reason=reason), lambda reply: self._show(reply.text))
        return True
