"""How well the datagrams of each robot arrive here. Pure: beacons and times in, figures out.

A robot numbers the beacons that it sends to all, so that a gap in the numbers is a loss. Loss is
measured in one direction: from the sender to this robot.
"""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct

from swarmd.link.datagram import Address

WINDOW = 32
"""Beacons of a robot over which its loss is counted: half a minute of an idle robot."""
MAX_LINKS = 1024
ROUND_TRIP_KEPT = 60.0  # s for which a measured round trip is given
_GRACE = 0.5  # the share of a period by which a beacon may be late


class LinkQuality(Struct, frozen=True):
    """How well a robot is heard, over its last WINDOW beacons to all."""

    received: int  # the count of beacons that came
    lost: int  # beacons that are missing or overdue
    age: float  # s since the last beacon
    round_trip: float | None = None  # s; None: not measured in the last minute

    @property
    def loss(self) -> float:
        """The share of beacons that did not arrive, from 0 to 1."""
        return self.lost / max(self.received + self.lost, 1)


class _Link(Struct):
    """The beacons of one instance: the highest number, and a bit for each of the last WINDOW."""

    instance: bytes
    heard: float
    highest: int = 0
    seen: int = 0
    span: int = 0  # beacons since the first one, at most WINDOW
    round_trip: float | None = None
    measured: float = 0.0

    def take(self, number: int) -> None:
        """Note a beacon to all by its number; a copy of an earlier beacon changes nothing."""
        ahead = number - self.highest if self.span else 1
        if ahead > 0:
            self.highest = number
            self.seen = ((self.seen << min(ahead, WINDOW)) | 1) & ((1 << WINDOW) - 1)
            self.span = min(self.span + ahead, WINDOW)
        elif -ahead < self.span:
            self.seen |= 1 << -ahead


class LinkQualities:
    """The links to other robots; `period`: s between two beacons of an idle robot, at most."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._links: dict[str, _Link] = {}

    def on_beacon(self, robot: str, instance: bytes, number: int, now: float) -> None:
        """Note a beacon; `number` counts the beacons to all, and is 0 if sent to one robot."""
        link = self._links.get(robot)
        if link is None or link.instance != instance:
            self._links.pop(robot, None)
            while len(self._links) >= MAX_LINKS:
                del self._links[min(self._links, key=lambda name: self._links[name].heard)]
            link = self._links[robot] = _Link(instance, now)
        link.heard = now
        if number:
            link.take(number)

    def on_round_trip(self, robot: str, seconds: float, now: float) -> None:
        """Note that a robot answered a clock query after `seconds`."""
        link = self._links.get(robot)
        if link is not None:
            link.round_trip = seconds
            link.measured = now

    def drop_round_trips(self, robots: Iterable[str]) -> None:
        """Drop the round trips of robots that are asked again, or are gone."""
        for robot in robots:
            if link := self._links.get(robot):
                link.round_trip = None

    def quality(self, robot: str, now: float) -> LinkQuality | None:
        """How well a robot is heard; None for a robot that was never heard."""
        link = self._links.get(robot)
        if link is None:
            return None
        age = max(now - link.heard, 0.0)
        # Silence leaves no gap in the numbers: beacons that are overdue count as lost.
        overdue = min(int(max(age / self._period - _GRACE, 0.0)), WINDOW)
        received = (link.seen & ((1 << (WINDOW - overdue)) - 1)).bit_count()
        lost = min(link.span + overdue, WINDOW) - received
        is_recent = now - link.measured <= ROUND_TRIP_KEPT
        return LinkQuality(received, lost, age, link.round_trip if is_recent else None)

    def forget(self, robot: str) -> None:
        """Forget a robot."""
        self._links.pop(robot, None)


class WaysHeard:
    """By which ways the datagrams of each address arrived: multicast, broadcast, unicast."""

    def __init__(self, lease: float) -> None:
        self._lease = lease
        self._heard: dict[Address, dict[str, float]] = {}

    def on_heard(self, address: Address, way: str, now: float) -> None:
        """Note a beacon that came from an address by the way `way`."""
        ways = self._heard.pop(address, None)
        if ways is None:
            while len(self._heard) >= MAX_LINKS:
                del self._heard[next(iter(self._heard))]
            ways = {}
        self._heard[address] = ways
        ways[way] = now

    def of(self, address: Address, now: float) -> tuple[str, ...]:
        """The ways by which something came within the lease."""
        ways = self._heard.get(address, {})
        return tuple(sorted(way for way, at in ways.items() if now - at <= self._lease))
