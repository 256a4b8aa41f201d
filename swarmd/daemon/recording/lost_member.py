"""What a robot knew of a peer at the moment at which it declared the peer failed.

The daemon records it on the topic LOST: links and beacons are no input of the robot, so that
nothing else in a recording tells them.
"""

from __future__ import annotations

from msgspec import Struct

from swarmd.core.bounds import Count, Line, Name, Seconds, Word
from swarmd.core.goal import HeldGoal
from swarmd.core.record import RecordKind
from swarmd.link.datagram import STATES, Beacon
from swarmd.link.members.link_quality import LinkQuality

LOST = "/lost"


class LostMember(Struct, frozen=True, kw_only=True):
    """A peer that has failed, as its last beacon and the link to it showed it.

    - `age`: s since its last beacon; None: not known.
    - `received`, `lost`: its last beacons. `round_trip`: s; None: not measured in the last minute.
    - `goal`: the goal that its last beacon showed, if this robot held the same one; else empty.
    """

    robot: Name
    state: Word
    platform: Word = ""
    age: Seconds | None = None
    received: Count = 0
    lost: Count = 0
    round_trip: Seconds | None = None
    goal: Line = ""

    @classmethod
    def of(cls, beacon: Beacon, link: LinkQuality | None, goal: HeldGoal | None) -> LostMember:
        """From its last beacon, the link to it, and the goal that this robot holds."""
        states = STATES[beacon.state : beacon.state + 1]
        is_same = goal is not None and goal.digest == beacon.digest(RecordKind.GOAL)
        return cls(
            robot=beacon.robot,
            state=states[0].value if states else "unknown",
            platform="" if beacon.body is None else beacon.body.platform,
            age=None if link is None else link.age,
            received=0 if link is None else link.received,
            lost=0 if link is None else link.lost,
            round_trip=None if link is None else link.round_trip,
            goal=goal.goal.text if goal is not None and is_same else "",
        )
