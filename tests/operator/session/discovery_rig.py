"""A look of an operator without a network: datagrams and views in, the discovery out."""

from __future__ import annotations

from typing import Any

from swarmd.core import codec
from swarmd.core.messages import Member, PeerView, Presence, State
from swarmd.link.datagram import PRESENCES, STATES, Beacon, MemberList, MemberReport
from swarmd.operator.session.discovery import (
    Discovery,
)
from swarmd.operator.session.members_view import Contact
from tests.support.fake_daemon import light_status

ALIVE, LEFT, FAILED = Presence.ALIVE, Presence.LEFT, Presence.FAILED


def life(instance: int = 1) -> bytes:
    return bytes([instance] * 6)


def beacon(robot: str, *, instance: int = 1, sequence: int = 1, **changes: Any) -> Beacon:
    fields = {"wire": codec.VERSION, "state": STATES.index(State.RUNNING), "revision": 0} | changes
    return Beacon(robot=robot, instance=life(instance), sequence=sequence, **fields)


def heard(
    robot: str, presence: Presence = ALIVE, *, instance: int = 1, age: int = 0
) -> MemberReport:
    return MemberReport(
        robot=robot,
        instance=life(instance),
        presence=PRESENCES.index(presence),
        age=age,
        host="10.0.0.9",
        port=7440,
    )


def word(
    robot: str,
    *others: MemberReport,
    part: int = 0,
    parts: int = 1,
    echo: int = 0,
    roster: Any = (),
) -> MemberList:
    return MemberList(
        robot=robot,
        instance=life(),
        members=others,
        part=part,
        parts=parts,
        echo=echo,
        roster=roster,
    )


def view(robot: str, *others: str, instance: int = 1, roster: tuple[str, ...] = ()) -> PeerView:
    members = tuple(
        Member(robot=name, instance=life().hex(), presence=ALIVE, age=9.0) for name in others
    )
    status = light_status(robot, life(instance).hex())
    return PeerView(robot=robot, status=status, members=members, roster=roster)


def address(robot: str) -> tuple[str, int]:
    return (f"10.0.0.{ord(robot[0])}", 7440)


class Rig:
    """A look that began at 0. Beacons are numbered as they come, unless a test tells a number."""

    def __init__(self, *roster: str, needs_status: bool = True) -> None:
        self._sent = 0
        self.found = Discovery(0.0, roster, needs_status=needs_status)

    def look_again(self, now: float) -> None:
        """Another look of the same operator begins at `now`."""
        needs_status = self.found._needs_status
        self.found = Discovery(now, earlier=self.found.result(now), needs_status=needs_status)

    def hear(self, *robots: str, at: float = 0.01, **changes: Any) -> None:
        for robot in robots:
            self._sent += 1
            told = {"sequence": self._sent} | changes
            self.found.on_beacon(beacon(robot, **told), address(robot), at)

    def tell(self, robot: str, *others: MemberReport, at: float = 0.01, **changes: Any) -> None:
        self.found.on_member_list(word(robot, *others, **changes), at)

    def answer(self, robot: str, *others: str, at: float = 0.02, **changes: Any) -> None:
        self.found.on_view(view(robot, *others, **changes), at)

    def contact(self, robot: str, now: float = 0.1) -> Contact:
        return self.found.result(now).members[robot].contact
