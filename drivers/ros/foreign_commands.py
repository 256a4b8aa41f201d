"""Commands that a base gets from other nodes: on topics, and by goals of actions. Pure."""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from swarmd.drivers.ros.messages import ActionlibStatusArray, GoalStatusArray
from swarmd.drivers.ros.options import TopicOptions

YIELD_TIME = 2.0
"""Seconds for which the base is left to another node after its last command or goal."""
MAX_ZEROS = 3.0
"""Seconds of another node's zeros after which they are reported; a watchdog's last 2 s."""

_TWIST = struct.Struct("<6d")
_COMMANDS = ("Twist", "TwistStamped")


@dataclass(frozen=True, slots=True)
class ActionProtocol:
    """How actions tell the states of their goals.

    `status` follows the action's name in the topic. `active`: the states of a goal that may move
    the base. `cancel` is the command that ends all goals, with `{}` for the action's name. A
    status holds for `lasts` s; infinity: until the next one.
    """

    status: str
    message_type: type
    active: frozenset[int]
    cancel: str
    lasts: float = math.inf


ROS2_ACTIONS = ActionProtocol(
    "_action/status",
    GoalStatusArray,
    frozenset({1, 2, 3}),  # accepted, executing, canceling
    "ros2 service call {}/_action/cancel_goal action_msgs/srv/CancelGoal",
)
ROS1_ACTIONS = ActionProtocol(
    "status",
    ActionlibStatusArray,
    frozenset({1, 6}),  # active, preempting
    "rostopic pub -1 {}/cancel actionlib_msgs/GoalID -- '{{}}'",
    lasts=YIELD_TIME,  # it is repeated, 5 times per second unless its server is set otherwise
)


class ForeignCommands:
    """Commands and goals of other nodes that move the base.

    It tells which of them drives the base now. `topics`: those on which commands arrive, the
    driver's own first. `actions`: the actions by the topic of their status. `counts`: commands that
    arrived, by topic. Times are in s on one clock.
    """

    def __init__(
        self, options: TopicOptions, protocol: ActionProtocol, *, is_cmd_vel_shared: bool = False
    ) -> None:
        """Nothing received yet. `is_cmd_vel_shared`: commands on the first topic do not drive."""
        self.protocol = protocol
        self.topics = tuple(map(options.topic, (options.cmd_vel, *options.other_commands)))
        actions = map(options.topic, options.other_actions)
        self.actions = {f"{action}/{protocol.status}": action for action in actions}
        self.counts: Counter[str] = Counter()
        self._ignored = self.topics[:1] if is_cmd_vel_shared else ()
        self._until: dict[str, float] = {}  # per topic, the end of YIELD_TIME
        self._zeros_from = self._zero_at = -math.inf

    def take_command(self, topic: str, payload: bytes, types: Collection[str], now: float) -> bool:
        """Count a command; True unless it is zero. `types`: those that its publishers announce."""
        self.counts[topic] += 1
        is_known = not types or any(kind.rpartition("/")[2] in _COMMANDS for kind in types)
        if is_known and _is_zero(payload):
            if topic == self.topics[0]:
                self._zeros_from = now if now - self._zero_at > YIELD_TIME else self._zeros_from
                self._zero_at = now
            return False
        if topic not in self._ignored:
            self._until[topic] = now + YIELD_TIME
        return True

    def take_status(self, topic: str, message: Any, now: float) -> bool:
        """The states of an action's goals, by its class of messages; True if one may move."""
        is_active = any(goal.status in self.protocol.active for goal in message.status_list)
        if is_active:
            self._until[topic] = now + self.protocol.lasts
        else:
            self.end_goals(topic, now)
        return is_active

    def end_goals(self, topic: str, now: float) -> None:
        """The goals of the action with this topic of its status have ended, or its server has."""
        if self._until.get(topic, now) > now + YIELD_TIME:
            self._until[topic] = now + YIELD_TIME

    def source(self, now: float) -> str:
        """The topic of the command, or of the action's status, that drives; empty without one.

        An action comes first: zeros do not end it.
        """
        driving = [topic for topic, until in self._until.items() if now < until]
        return next((t for t in driving if t in self.actions), "") or next(iter(driving), "")

    def has_lasting_zeros(self, now: float) -> bool:
        """True if another node has stopped the robot for longer than a watchdog does."""
        duration = self._zero_at - self._zeros_from
        return duration > MAX_ZEROS and now - self._zero_at < YIELD_TIME


def _is_zero(payload: bytes) -> bool:
    """True if the last six numbers of a message are zero: a Twist ends both types of commands."""
    return len(payload) >= _TWIST.size and not any(_TWIST.unpack(payload[-_TWIST.size :]))
