"""One owner for each robot id: a claim by beacons. Pure: beacons and times in, the outcome out.

A daemon that starts sends beacons with Flag.JOINING and listens. The owner of the id answers each
of them, so that a claimer that hears an owner twice has lost; one alone may be a delayed beacon
of a daemon that has ended. Of several claimers the smallest instance wins. A claim is won after
`settle` seconds of listening without a rival. Listening is counted from look to look, and at most
LONGEST_LOOK of it each time: after a stall the beacons of others may still wait to be read. So a
claim takes settle / LONGEST_LOOK looks on a busy computer. Two owners can still meet when a cut
heals: `Membership` and the daemon then see the beacons of a second instance.
"""

from __future__ import annotations

from swarmd.network.datagram import Beacon, Flag

CLAIM_PERIOD = 0.05  # between beacons of a claimer, in s
RIVAL_TIMEOUT = 0.5  # a claimer that is silent for so long has given up, in s
LONGEST_LOOK = 0.15  # s of listening that count between two looks
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
        """A beacon arrived; those of other robots are ignored."""
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
        """True once the id belongs to this instance; call it at least each LONGEST_LOOK."""
        self._listened += min(now - self._checked_at, LONGEST_LOOK)
        self._checked_at = now
        for rival, heard in list(self._claimers.items()):
            if now - heard > RIVAL_TIMEOUT:
                del self._claimers[rival]
        is_free = self.holder is None and not self._claimers
        return is_free and self._listened >= self._settle - ROUNDING
