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
"""Seconds after the last command or goal of another node for which that node counts as driving."""
MAX_ZEROS = 3.0
"""Seconds of another node's zeros after which they are reported; a watchdog's last 2 s."""

_TWIST = struct.Struct("<6d")
_COMMANDS = ("Twist", "TwistStamped")


@dataclass(frozen=True, slots=True)
class ActionProtocol:
    """How the servers of actions publish the states of their goals."""

    status: str  # the topic's name behind the action's name
    message_type: type
    active: frozenset[int]  # states in which a goal may move the base
    cancel: str  # the command that ends all goals; `{}`: the action's name
    lasts: float = math.inf  # s for which a status holds; inf: until the next status


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
    """Tracks which other node drives the base, by its commands and its goals of actions.

    `topics`: the topics of commands, the driver's own first. `actions`: maps the topic on which the
    server of an action publishes the states of goals to the name of the action. `counts`: the
    number of commands that have arrived, by topic. Times are in s on one clock.
    """

    def __init__(
        self, options: TopicOptions, protocol: ActionProtocol, *, is_cmd_vel_shared: bool = False
    ) -> None:
        """`is_cmd_vel_shared`: commands of others on the first topic do not count as driving."""
        self.protocol = protocol
        self.topics = tuple(map(options.topic, (options.cmd_vel, *options.other_commands)))
        actions = map(options.topic, options.other_actions)
        self.actions = {f"{action}/{protocol.status}": action for action in actions}
        self.counts: Counter[str] = Counter()
        self._ignored = self.topics[:1] if is_cmd_vel_shared else ()
        self._until: dict[str, float] = {}  # by topic: when its node no longer counts as driving
        self._zeros_from = -math.inf
        self._zero_at = -math.inf

    def take_command(self, topic: str, payload: bytes, types: Collection[str], now: float) -> bool:
        """Count a command of another node; False for zero, which does not move the base.

        `types`: the message types that the topic's publishers announce. With another type than
        Twist and TwistStamped the bytes cannot be read, and the command counts as not zero.
        """
        self.counts[topic] += 1
        is_known = not types or any(kind.rpartition("/")[2] in _COMMANDS for kind in types)
        if is_known and _is_zero(payload):
            if topic == self.topics[0]:
                if now - self._zero_at > YIELD_TIME:  # a new series of zeros begins
                    self._zeros_from = now
                self._zero_at = now
            return False
        if topic not in self._ignored:
            self._until[topic] = now + YIELD_TIME
        return True

    def take_status(self, topic: str, message: Any, now: float) -> bool:
        """Take the states of an action's goals; True if a goal may move the base."""
        is_active = any(goal.status in self.protocol.active for goal in message.status_list)
        if is_active:
            self._until[topic] = now + self.protocol.lasts
        else:
            self.end_goals(topic, now)
        return is_active

    def end_goals(self, topic: str, now: float) -> None:
        """Note that the goals of an action, or its server, have ended; `topic`: of its status."""
        if self._until.get(topic, now) > now + YIELD_TIME:
            self._until[topic] = now + YIELD_TIME

    def source(self, now: float) -> str:
        """The topic of the commands, or of the action's status, that drives the base now.

        Empty if no other node drives. If both drive, the action counts: commands of zero do not end
        the goal of an action.
        """
        driving = [topic for topic, until in self._until.items() if now < until]
        acting = [topic for topic in driving if topic in self.actions]
        return next(iter((*acting, *driving)), "")

    def has_lasting_zeros(self, now: float) -> bool:
        """True if another node has stopped the robot for longer than a watchdog does."""
        duration = self._zero_at - self._zeros_from
        return duration > MAX_ZEROS and now - self._zero_at < YIELD_TIME


def _is_zero(payload: bytes) -> bool:
    """True if the last six numbers are 0: Twist and TwistStamped both end with these fields."""
    return len(payload) >= _TWIST.size and not any(_TWIST.unpack(payload[-_TWIST.size :]))
