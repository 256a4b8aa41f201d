"""Opinions between the pattern of this robot and robots without swarmd, such as ROS robots.

1. Nothing proves the sender of a heard opinion. So the sender gets the name `ros:<name>`, which no
   robot of the swarm can have. The first opinion of each sender is an event.
2. An opinion in the name of a robot of the swarm is dropped: that robot votes by itself.
3. A secured swarm hears only robots that the option `opinions` declares. The first opinion of an
   undeclared robot is an event.
4. A sender may send as many messages a second as the pattern of a robot (`SenderLimits`). At most
   MAX_SENDERS senders are heard.
5. Only opinions from 0 to MAX_OPINION are heard and published.
"""

from __future__ import annotations

from collections.abc import Callable, Collection

from swarmd.core.clock import boottime
from swarmd.core.events import MessageInput
from swarmd.core.message_limits import SenderLimits
from swarmd.core.values import OPINION, ROUND_VOTE, Value
from swarmd.driver_api.opinion_link import HeardOpinion, OpinionLink, number_of
from swarmd.network.carriers.inbound_queue import DropCounter

MAX_SENDERS = 64
MAX_OPINION = 999
PREFIX = "ros:"
_SIZE = 3  # bytes of an encoded opinion, at most


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
        if name != OPINION or not isinstance(value, int) or isinstance(value, bool):
            return
        if 0 <= value <= MAX_OPINION:
            self._link.publish(value)
        else:
            self._drops.add("opinion:malformed")

    def _hear(self, heard: HeardOpinion) -> None:
        """Hand an opinion to the pattern, or drop it."""
        # 1. The limits, before the checks that take longer: a flood must not delay the daemon.
        sender = f"{PREFIX}{heard.name}"
        is_new = sender not in self._limits
        limits = SenderLimits() if is_new else self._limits[sender]
        if not limits.passes(OPINION, _SIZE, self._clock()):
            self._drops.add("opinion:limit")
            return
        if is_new and len(self._limits) >= MAX_SENDERS:
            self._drops.add("opinion:full")
            return
        # 2. The sender.
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
        if is_new:
            self._limits[sender] = limits
            self._on_event(f"hears opinions of the ROS robot {heard.name}, not authenticated")
        # 3. The opinion.
        channel = self._channel()
        if not 0 <= heard.opinion <= MAX_OPINION:
            self._drops.add("opinion:malformed")
        elif channel is not None:
            self._step(MessageInput(sender, channel, heard.opinion, is_program=True, size=_SIZE))

    def _is_of_swarm(self, heard: HeardOpinion) -> bool:
        """True if a robot of the swarm has this name (with `_` for `-`), or this number."""
        if heard.number is not None:
            end = str(heard.number)  # compared first, since `number_of` takes longer
            return any(
                robot.endswith(end) and number_of(robot) == heard.number for robot in self._robots()
            )
        name = heard.name.replace("-", "_")
        return any(name == robot.replace("-", "_") for robot in self._robots())
