"""What an operator has seen of a robot: the statuses it answered with, and its `SeenMember`. Pure.

A `SeenMember` is made from the robot's beacons, its status and the reports of other robots.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, KeysView, Mapping

from msgspec import Struct

from swarmd.core import codec
from swarmd.core.messages import Epoch, Member, Presence, Status, StatusHeader
from swarmd.link.datagram import STATES, Beacon
from swarmd.link.members.membership import MAX_INSTANCES, Life
from swarmd.operator.session.member_reports import PeerReport
from swarmd.operator.session.members_view import Contact, SeenMember


class StatusAnswer(Struct, frozen=True):
    """The answer of a robot to a query of its status."""

    status: Status | StatusHeader  # a header from a robot of another version
    members: tuple[Member, ...]  # the members as the robot sees them
    at: float  # when the status came, in s


class StatusTable:
    """The newest answer of each instance."""

    def __init__(self) -> None:
        self._answers: dict[str, dict[str, StatusAnswer]] = {}

    def add(self, robot: str, answer: StatusAnswer) -> bool:
        """Keep an answer; True if it is the first answer of its instance."""
        known = self._answers.setdefault(robot, {})
        instance = answer.status.instance
        is_new = instance not in known
        if not is_new or len(known) < MAX_INSTANCES:
            known[instance] = answer
            return is_new
        return False

    def drop(self, robot: str, instance: str) -> None:
        """Drop the answer of an instance that left."""
        self._answers.get(robot, {}).pop(instance, None)

    @property
    def robots(self) -> KeysView[str]:
        """The robots of which an instance has answered, whether or not that instance left."""
        return self._answers.keys()

    def instances(self, robot: str) -> Mapping[str, StatusAnswer]:
        """The answers of the instances of a robot that did not leave."""
        return self._answers.get(robot, {})

    def newest(self, robot: str, living: Collection[str]) -> StatusAnswer | None:
        """The newest answer of a robot; only of instances in `living`, unless that is empty."""
        answers = self.instances(robot).values()
        counted = [answer for answer in answers if not living or answer.status.instance in living]
        return max(counted, key=lambda answer: answer.at, default=None)

    def statuses(self) -> Iterator[tuple[str, Status, tuple[Member, ...]]]:
        """The robot, the status and the members of each answer of this version."""
        for robot, answers in self._answers.items():
            for answer in answers.values():
                if isinstance(answer.status, Status):
                    yield robot, answer.status, answer.members

    def agree(self, robots: Collection[str]) -> bool:
        """True if at least two robots answered, and each lists all of `robots` as alive."""
        views = [(robot, members) for robot, _, members in self.statuses()]
        if len(robots) < 2 or len(views) < 2:
            return False
        return all(
            set(robots)
            <= {robot} | {member.robot for member in members if member.presence is Presence.ALIVE}
            for robot, members in views
        )


INDIRECT_TIME = 10.0  # s for which a robot that only other robots heard counts as alive


def present_member(
    robot: str, heard: Life | None, answer: StatusAnswer | None, now: float
) -> SeenMember:
    """The member `robot`, which is heard or has answered, at `now` in s.

    `heard`: the life of the robot whose beacons this operator hears; None without a beacon.
    `answer`: the robot's answer to a query of its status; None without an answer. Of a robot of
    another version only the head of the status can be read. Values of the status count before
    values of the beacon.
    """
    if answer is None:
        return _member_by_beacon(robot, heard, now)
    status = answer.status
    beacon = heard.beacon if heard is not None else None
    is_other_version = isinstance(status, StatusHeader) or _is_other_version(beacon)
    return SeenMember(
        robot=robot,
        instance=status.instance,
        presence=Presence.ALIVE,
        age=max(now - answer.at, 0.0),
        status=status if isinstance(status, Status) else None,
        contact=Contact.OTHER_VERSION if is_other_version else Contact.ANSWERED,
        state=status.state,
        wire=beacon.wire if beacon else None,
        version=status.version,
        header=status if isinstance(status, StatusHeader) else None,
        epoch=status.epoch if isinstance(status, Status) else _epoch_of(beacon),
    )


def _member_by_beacon(robot: str, heard: Life | None, now: float) -> SeenMember:
    """The member `robot`, which has not answered; `heard`: the life of its newest beacon."""
    beacon = heard.beacon if heard is not None else None
    has_known_state = beacon is not None and beacon.state < len(STATES)
    is_other_version = _is_other_version(beacon)
    return SeenMember(
        robot=robot,
        instance="unknown" if beacon is None else beacon.instance.hex(),
        presence=Presence.ALIVE,
        age=0.0 if heard is None else max(now - heard.heard, 0.0),
        status=None,
        contact=Contact.OTHER_VERSION if is_other_version else Contact.NO_ANSWER,
        state=STATES[beacon.state] if beacon is not None and has_known_state else "",
        wire=beacon.wire if beacon else None,
        version=heard.version if heard else "",
        epoch=_epoch_of(beacon),
    )


def _is_other_version(beacon: Beacon | None) -> bool:
    return beacon is not None and beacon.wire != codec.VERSION


def _epoch_of(beacon: Beacon | None) -> Epoch | None:
    return None if beacon is None else Epoch(beacon.instance.hex(), beacon.revision)


def silent_member(
    robot: str,
    heard: Life | None,
    answer: StatusAnswer | None,
    report: PeerReport | None,
    now: float,
) -> SeenMember | None:
    """The member `robot`, whose beacons do not arrive at this operator now.

    `heard`: the last life (start to end of a daemon) that this operator heard, and that did not
    leave. `answer`: the last answer to a query of the robot's status. `report`: the most certain
    report on the robot, by other robots or by its own farewell. Returns None for a robot that was
    neither heard nor reported.

    1. If the last beacon of the robot reached this operator after the report, the robot has failed.
    2. A robot that another robot heard within INDIRECT_TIME is alive and unreachable.
    3. Any other robot that is reported alive has failed.
    4. Else the robot has left or failed, as reported.
    """
    if heard is not None and (report is None or report.at <= heard.heard):
        report = PeerReport(heard.beacon.instance.hex(), Presence.FAILED, heard.heard)
    if report is None:
        return None
    presence = report.presence
    contact = Contact.GONE
    is_recent = now - report.at <= INDIRECT_TIME
    if presence is Presence.ALIVE and is_recent:
        contact = Contact.UNREACHABLE
    elif presence is Presence.ALIVE:
        presence = Presence.FAILED
    return SeenMember(
        robot=robot,
        instance=report.instance,
        presence=presence,
        age=max(now - report.at, 0.0),
        status=answer.status if answer and isinstance(answer.status, Status) else None,
        contact=contact,
        by=report.by,
    )
