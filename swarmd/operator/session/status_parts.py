"""The statuses that robots tell by datagram to a look of an operator. Pure.

A robot that tells its status announces the number of parts in the beacon that answers the solicit
(`Beacon.status_parts`), and sends the parts after it. A robot of an earlier version, of a secured
swarm, or with a long status announces none: its status is asked for on a link. So is that of a
robot whose parts do not arrive within a time.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from math import inf

from swarmd.core import codec
from swarmd.core.bounds import keep_newest
from swarmd.core.codec import Decoder, version_of
from swarmd.core.messages import Status, StatusHeader
from swarmd.link.datagram import Beacon, StatusPart
from swarmd.link.members.membership import MAX_INSTANCES, MAX_MEMBERS
from swarmd.operator.session.round_trips import MOST_INSTANCES

# How long a look waits for the datagrams of a status before it dials the robot: s, and round trips.
PARTS_WAIT = 0.3
PARTS_TRIPS = 4.0
# A robot is asked again after these s, or after this number of round trips if that is longer.
ASK_PERIOD = 0.1
ASK_TRIPS = 1.5

Instance = tuple[str, str]
"""A robot, and one life of its daemon in hex."""


class StatusParts:
    """The parts that came of each instance, and which instances tell none."""

    def __init__(self) -> None:
        self._asked: set[int] = set()  # the numbers of the solicits that asked for statuses
        self._asked_at: dict[Instance, float] = {}
        # By robot and instance: the parts of the answer to the last solicit that it answered.
        self._parts: dict[str, dict[str, dict[int, StatusPart]]] = {}
        self.refusing: dict[Instance, None] = {}
        """The instances whose last answer announced no parts: they are asked on a link."""

    @property
    def has_asked(self) -> bool:
        """True once a solicit has asked for statuses."""
        return bool(self._asked)

    def on_asked(self, echo: int) -> None:
        """Note that the solicit with this number asks for statuses."""
        self._asked.add(echo)

    def begin_asks(
        self, instances: Iterable[Instance], now: float, round_trip: float, most: int
    ) -> list[Instance]:
        """Of `instances` those to ask again now, at most `most`; the call notes that they are.

        Those that were asked longest ago come first, so that in a large swarm each gets its turn.
        """
        period = max(ASK_PERIOD, ASK_TRIPS * round_trip)
        due = [
            (self._asked_at.get(one, -inf), one)
            for one in instances
            if one not in self.refusing and now - self._asked_at.get(one, -inf) >= period
        ]
        begun = [one for _, one in sorted(due)[:most]]
        for one in begun:
            keep_newest(self._asked_at, one, now, MOST_INSTANCES)
        return begun

    def on_beacon(self, beacon: Beacon, now: float) -> None:
        """Note what an answer announces; the beacon of an instance that is heard."""
        if beacon.echo not in self._asked:
            return
        instance = (beacon.robot, beacon.instance.hex())
        if instance not in self._asked_at:
            keep_newest(self._asked_at, instance, now, MOST_INSTANCES)
        if beacon.status_parts:
            self.refusing.pop(instance, None)
        else:
            keep_newest(self.refusing, instance, None, MOST_INSTANCES)

    def add(self, part: StatusPart) -> bytes | None:
        """Keep a part; the encoded status once all parts of one answer have come.

        The parts of the last solicit that was answered are kept: a status is never put together of
        two answers. A part that answers no solicit of this look is dropped.
        """
        if part.echo not in self._asked or part.part >= part.parts:
            return None
        if part.robot not in self._parts and len(self._parts) >= MAX_MEMBERS:
            return None
        instances = self._parts.setdefault(part.robot, {})
        instance = part.instance.hex()
        if instance not in instances and len(instances) >= MAX_INSTANCES:
            return None
        parts = instances.setdefault(instance, {})
        known = next(iter(parts.values()), part)
        if part.echo < known.echo:
            return None
        if part.echo > known.echo or part.parts != known.parts:
            parts.clear()
        parts[part.part] = part
        if len(parts) < part.parts:
            return None
        content = b"".join(parts[number].content for number in range(part.parts))
        parts.clear()
        return content

    @staticmethod
    def wait(round_trip: float) -> float:
        """How many s after a robot became known its status is asked for on a link."""
        return PARTS_WAIT + PARTS_TRIPS * round_trip


def decode_status(content: bytes) -> Status | StatusHeader:
    """An encoded status; of another version its header. CodecError if it cannot be read."""
    if version_of(content) == codec.VERSION:
        return _status_decoder()(content)
    return _header_decoder()(content)


# Made at the first status: most verbs read none.
@cache
def _status_decoder() -> Decoder[Status]:
    return Decoder(Status)


@cache
def _header_decoder() -> Decoder[StatusHeader]:
    return Decoder(StatusHeader, any_version=True)
