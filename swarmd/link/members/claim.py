"""One owner for each robot id: a claim by beacons. Pure: beacons and times in, the outcome out.

A beacon is the datagram by which a daemon shows its id and its instance (a random number).

1. A daemon that starts (a claimer) sends beacons with Flag.JOINING and listens.
2. The owner of the id answers each beacon of a claimer. A claimer that hears two beacons of the
   owner has lost. A single beacon may be a delayed beacon of a daemon that has ended.
3. Of several claimers the claimer with the smallest instance wins.
4. A claim is won after `settle` seconds of listening without a rival. Each call of `is_won` counts
   the time since the last call as listening, but at most LONGEST_LOOK: after a stall of the
   process, beacons of rivals may still wait to be read.

Two owners of an id can still meet when two parts of a network are joined again: `Membership` and
the daemon then see the beacons of a second instance.
"""

from __future__ import annotations

from swarmd.link.datagram import Beacon, Flag

CLAIM_PERIOD = 0.05  # between beacons of a claimer, in s
RIVAL_TIMEOUT = 0.5  # s of silence after which a claimer has given up
LONGEST_LOOK = 0.15  # s of listening that count at most between two calls of `is_won`
MAX_RIVALS = 64
ROUNDING = 1e-9  # s


class Claim:
    """The claim of `instance` on an id, begun at `now`."""

    def __init__(self, robot: str, instance: bytes, settle: float, now: float) -> None:
        self._robot = robot
        self._own = instance
        self._settle = settle
        self._listened = 0.0  # s since a rival was heard
        self._checked_at = now
        self._owners: dict[bytes, int] = {}  # the sequence of the first beacon heard of each
        self._claimers: dict[bytes, float] = {}
        self.holder: bytes | None = None

    def on_beacon(self, beacon: Beacon, now: float) -> None:
        """Note a beacon of a rival; beacons with another robot id are ignored."""
        if beacon.robot != self._robot or beacon.instance == self._own:
            return
        if beacon.flags & Flag.LEFT:
            self._owners.pop(beacon.instance, None)
            self._claimers.pop(beacon.instance, None)
            if self.holder == beacon.instance:
                self.holder = None
        elif beacon.flags & Flag.JOINING:
            if beacon.instance < self._own and len(self._claimers) < MAX_RIVALS:
                self._claimers[beacon.instance] = now
                self._listened = 0.0
        else:
            self._listened = 0.0
            if len(self._owners) < MAX_RIVALS:
                first = self._owners.setdefault(beacon.instance, beacon.sequence)
                if beacon.sequence != first:
                    self.holder = beacon.instance

    @property
    def rivals(self) -> tuple[bytes, ...]:
        """Instances that own or claim the id, as far as they were heard."""
        return (*self._owners, *self._claimers)

    def is_won(self, now: float) -> bool:
        """Count the time of listening; True once the id belongs to this instance.

        Call it at least each LONGEST_LOOK: a call counts the time since the call before, up to
        LONGEST_LOOK.
        """
        self._listened += min(now - self._checked_at, LONGEST_LOOK)
        self._checked_at = now
        for rival, heard in list(self._claimers.items()):
            if now - heard > RIVAL_TIMEOUT:
                del self._claimers[rival]
        is_free = self.holder is None and not self._claimers
        return is_free and self._listened >= self._settle - ROUNDING
