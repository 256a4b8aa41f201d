"""The robots that an operator hears itself, by their beacons, with round trip and loss. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, auto

from msgspec import Struct

from swarmd.core import codec
from swarmd.network.datagram import Address, Beacon, Flag

MAX_ROBOTS = 1024
MAX_INSTANCES = 8
MAX_ECHOES = 256
FRESH_TIME = 3.0  # a beacon counts for this long, in s
# An answer takes at most this long beside the round trip, in s.
QUIET_TIME = 0.1
# The bound of the round trip, in s, which is the longest of a few robots and the median of many.
MAX_ROUND_TRIP, FEW_ROBOTS = 5.0, 8


class HeardInstance(Struct):
    """An instance that the operator hears itself: its newest beacon, and times in s.

    `asked`: solicits that were sent before it was first heard. `echoes`: those that it answered.
    """

    beacon: Beacon
    address: Address
    first: float
    last: float
    asked: int
    echoes: set[int] = set()
    version: str = ""


class BeaconChange(Enum):
    """What a beacon changed: nothing, the figures of an instance, or which instances there are."""

    IGNORED = auto()
    REFRESHED = auto()
    FOUND = auto()
    LEFT = auto()


class BeaconTable:
    """The instances that an operator hears, and those that said that they leave."""

    def __init__(self) -> None:
        self.solicits = 0  # that were sent
        self._heard: dict[str, dict[str, HeardInstance]] = {}
        # The instances that said that they leave: when, and the sequence of that beacon.
        self._gone: dict[tuple[str, str], tuple[float, int]] = {}
        # Those that were heard after that: it was not their own beacon.
        self._returned: set[tuple[str, str]] = set()
        self._echoes: dict[int, float] = {}
        self._trips: dict[str, float] = {}

    # Events

    def on_solicit(self, echo: int, now: float) -> None:
        """A `Solicit` with this number is sent now."""
        self.solicits += 1
        self._echoes[echo] = now
        if len(self._echoes) > MAX_ECHOES:
            del self._echoes[next(iter(self._echoes))]

    def on_beacon(
        self, beacon: Beacon, address: Address, now: float, *, has_room: bool
    ) -> BeaconChange:
        """A robot's own beacon came; without `has_room` no further robot or instance is taken."""
        instance = beacon.instance.hex()
        known = self._heard.get(beacon.robot, {})
        who = (beacon.robot, instance)
        if beacon.flags & Flag.LEFT:
            is_newest = instance in known and beacon.sequence >= known[instance].beacon.sequence
            if not is_newest or who in self._returned:
                return BeaconChange.IGNORED
            del known[instance]
            self._gone[who] = (now, beacon.sequence)
            while len(self._gone) > MAX_ROBOTS:
                del self._gone[next(iter(self._gone))]
            return BeaconChange.LEFT
        if who in self._gone:
            left_at, sequence = self._gone[who]
            has_answered = self._echoes.get(beacon.echo, left_at) > left_at
            if beacon.sequence <= sequence and not has_answered:
                return BeaconChange.IGNORED  # a delayed beacon of a robot that has left
            del self._gone[who]
            if len(self._returned) < MAX_ROBOTS:
                self._returned.add(who)
        is_new, is_full = instance not in known, len(known) >= MAX_INSTANCES or not has_room
        if beacon.flags & Flag.JOINING or (is_new and is_full):
            return BeaconChange.IGNORED
        if is_new:
            known = self._heard.setdefault(beacon.robot, known)
            known[instance] = HeardInstance(beacon, address, now, now, self.solicits)
        heard = known[instance]
        heard.last = now
        if beacon.sequence >= heard.beacon.sequence:  # an older beacon may arrive later
            heard.address, heard.beacon = address, beacon
        heard.version = beacon.version or heard.version
        return BeaconChange.FOUND if is_new else BeaconChange.REFRESHED

    def on_echo(self, beacon: Beacon, now: float) -> None:
        """Measure the round trip, if a beacon that was taken answers a solicit."""
        heard = self._heard[beacon.robot][beacon.instance.hex()]
        sent = self._echoes.get(beacon.echo)
        if sent is not None and beacon.echo not in heard.echoes:
            heard.echoes.add(beacon.echo)
            trip = max(now - sent, 0.0)
            self._trips[beacon.robot] = min(trip, self._trips.get(beacon.robot, trip))

    # What is known

    @property
    def robots(self) -> frozenset[str]:
        """The robots that were heard and did not leave."""
        return frozenset(robot for robot, instances in self._heard.items() if instances)

    @property
    def of_other_version(self) -> frozenset[str]:
        """The robots whose beacons show another version of requests."""
        return frozenset(
            robot
            for robot, instances in self._heard.items()
            if any(one.beacon.wire != codec.VERSION for one in instances.values())
        )

    @property
    def gone(self) -> Mapping[tuple[str, str], tuple[float, int]]:
        """When each (robot, instance) that left said so, and the sequence of that beacon."""
        return self._gone

    def instances(self, robot: str) -> Mapping[str, HeardInstance]:
        """The instances of a robot that were heard and did not leave."""
        return self._heard.get(robot, {})

    def newest(self, robot: str) -> HeardInstance | None:
        """The instance of a robot that was heard last."""
        return max(self.instances(robot).values(), key=lambda one: one.last, default=None)

    def living(self, robot: str) -> set[str]:
        """The instances of a robot that are alive by their beacons; several hold one id."""
        heard = self.instances(robot)
        newest = max((one.first for one in heard.values()), default=0.0)
        latest = max((one.last for one in heard.values()), default=0.0)
        # An older one counts if it was heard after the newest appeared: a restart is no duplicate.
        return {
            instance
            for instance, one in heard.items()
            if one.first == newest or (one.last > newest and latest - one.last <= FRESH_TIME / 2)
        }

    def is_fresh(self, robot: str, now: float) -> bool:
        """True if a beacon of a robot came lately."""
        return any(now - one.last <= FRESH_TIME for one in self.instances(robot).values())

    @property
    def round_trip(self) -> float:
        """The round trip, in s: the longest, the median of many robots; 0 without an answer.

        Robots that answered one solicit alone count only while no robot answered two.
        """
        twice = {
            robot
            for robot, instances in self._heard.items()
            if any(len(one.echoes) > 1 for one in instances.values())
        }
        trips = sorted(trip for robot, trip in self._trips.items() if not twice or robot in twice)
        if not trips:
            return 0.0
        trip = trips[-1] if len(trips) <= FEW_ROBOTS else trips[len(trips) // 2]
        return min(trip, MAX_ROUND_TRIP)

    def loss(self, now: float) -> float:
        """The largest share of solicits that a robot which is heard left unanswered, 0 to 1."""
        trip, worst = self.round_trip, 0.0
        recent = sum(1 for at in self._echoes.values() if now - at <= trip + QUIET_TIME)
        for instances in self._heard.values():
            for one in instances.values():
                asked = self.solicits - recent - max(one.asked - 1, 0)
                if asked >= 4 and now - one.last <= FRESH_TIME:
                    worst = max(worst, 1.0 - len(one.echoes) / asked)
        return min(max(worst, 0.0), 1.0)
