"""Opinions between the pattern of this robot and robots without swarmd, such as ROS robots.

1. The sender of a heard opinion gets a name that no robot of the swarm can have, `ros:<name>`:
   nothing proves the sender. The first opinion of each sender is an event.
2. An opinion in the name of a robot of the swarm is dropped: that robot votes by itself.
3. A secured swarm hears declared robots alone; the first other robot is an event.
4. A sender has the limits of a robot's pattern; at most MAX_SENDERS senders are heard.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection

from swarmd.core.clock import boottime
from swarmd.core.events import MessageInput
from swarmd.core.message_limits import SenderLimits
from swarmd.core.values import OPINION, ROUND_VOTE, Value
from swarmd.driver_api.opinion_link import HeardOpinion, OpinionLink
from swarmd.network.carriers.inbound_queue import DropCounter

MAX_SENDERS = 64
MAX_OPINION = 999
PREFIX = "ros:"
_SIZE = 3  # bytes of an encoded opinion, at most
_OTHER = re.compile(r"[^A-Za-z0-9_]")
_NUMBER = re.compile(r"\d{1,9}$")


class ForeignOpinions:
    """Hands heard opinions to the running pattern, and publishes the opinion of that pattern.

    `channel`: returns the name of the channel on which the running pattern gets opinions, None
    without such a pattern. `robots`: returns the names of the robots of the swarm. `step` takes the
    messages, `on_event` a line for the events. `drops` counts dropped opinions.
    """

    def __init__(
        self,
        link: OpinionLink,
        channel: Callable[[], str | None],
        robots: Callable[[], Collection[str]],
        step: Callable[[MessageInput], None],
        on_event: Callable[[str], None],
        *,
        is_secured: bool,
        drops: DropCounter,
        clock: Callable[[], float] = boottime,
    ) -> None:
        """Hear opinions from now on."""
        self._link, self._channel, self._robots = link, channel, robots
        self._step, self._on_event = step, on_event
        self._is_secured, self._drops, self._clock = is_secured, drops, clock
        self._limits: dict[str, SenderLimits] = {}  # by sender
        self._has_refused = False
        link.hear(self._hear)

    def on_sent(self, channel: str, value: Value) -> None:
        """Publish the opinion in a message of the own pattern; other messages are ignored."""
        name = channel.rpartition("/")[2]
        if name == ROUND_VOTE and isinstance(value, list) and len(value) > 1:
            name, value = OPINION, value[1]  # [round, opinion, previous opinion]
        if name == OPINION and isinstance(value, int) and not isinstance(value, bool):
            self._link.publish(value)

    def _hear(self, heard: HeardOpinion) -> None:
        """Hand an opinion to the pattern, or drop it."""
        # 1. The sender.
        if self._is_of_swarm(heard):
            self._drops.add("opinion:robot")
            return
        if self._is_secured and not heard.is_declared:
            self._drops.add("opinion:undeclared")
            if not self._has_refused:
                self._has_refused = True
                self._on_event(
                    f"opinions of the ROS robot {heard.name} and of further robots that the option"
                    " opinions does not name are refused: this swarm is secured"
                )
            return
        sender = f"{PREFIX}{heard.name}"
        limits = self._limits.get(sender)
        if limits is None:
            if len(self._limits) >= MAX_SENDERS:
                self._drops.add("opinion:full")
                return
            limits = self._limits[sender] = SenderLimits()
            self._on_event(f"hears opinions of the ROS robot {heard.name}, not authenticated")
        # 2. The opinion.
        channel = self._channel()
        if not 0 <= heard.opinion <= MAX_OPINION:
            self._drops.add("opinion:malformed")
        elif not limits.passes(OPINION, _SIZE, self._clock()):
            self._drops.add("opinion:limit")
        elif channel is not None:
            self._step(MessageInput(sender, channel, heard.opinion, is_program=True, size=_SIZE))

    def _is_of_swarm(self, heard: HeardOpinion) -> bool:
        """True if a robot of the swarm has this name (with `_` for `-`), or this number."""
        for robot in self._robots():
            number = _NUMBER.search(robot)
            if heard.number is None and heard.name in (robot, _OTHER.sub("_", robot)):
                return True
            if heard.number is not None and number and int(number[0]) == heard.number:
                return True
        return False
