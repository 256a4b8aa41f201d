"""Makes a robot's `SeenMember` from its beacons, its status and other robots' reports. Pure."""

from __future__ import annotations

from swarmd.core import codec
from swarmd.core.messages import Epoch, Presence, Status, StatusHeader
from swarmd.network.datagram import STATES
from swarmd.network.members.membership import Life
from swarmd.network.operator.member_reports import PeerReport
from swarmd.network.operator.members_view import Contact, SeenMember
from swarmd.network.operator.status_table import StatusAnswer

INDIRECT_TIME = 10.0  # s for which a robot that only other robots heard counts as alive


def present_member(
    robot: str, heard: Life | None, answer: StatusAnswer | None, now: float
) -> SeenMember:
    """The member `robot`, which is heard or has answered, at `now` in s.

    `heard`: the life of the robot whose beacons this operator hears; None without a beacon.
    `answer`: the robot's answer to a query of its status, for another version only the head of the
    status; None without an answer. What the status says counts before the beacon.
    """
    status = answer.status if answer is not None else None
    beacon = heard.beacon if heard is not None else None

    # 1. When the robot was last heard, and whether it answers.
    last_heard = now
    if answer is not None:
        last_heard = answer.at
    elif heard is not None:
        last_heard = heard.heard
    if isinstance(status, StatusHeader) or (beacon and beacon.wire != codec.VERSION):
        contact = Contact.OTHER_VERSION
    else:
        contact = Contact.ANSWERED if isinstance(status, Status) else Contact.NO_ANSWER

    # 2. Instance, state and version.
    epoch = None if beacon is None else Epoch(beacon.instance.hex(), beacon.revision)
    instance, state = "unknown", ""
    version = heard.version if heard else ""
    if status is not None:
        instance, state = status.instance, status.state
        version = status.version
    elif beacon is not None:
        instance = beacon.instance.hex()
        state = STATES[beacon.state] if beacon.state < len(STATES) else ""
    return SeenMember(
        robot=robot,
        instance=instance,
        presence=Presence.ALIVE,
        age=max(now - last_heard, 0.0),
        status=status if isinstance(status, Status) else None,
        contact=contact,
        state=state,
        wire=beacon.wire if beacon else None,
        version=version,
        header=status if isinstance(status, StatusHeader) else None,
        epoch=status.epoch if isinstance(status, Status) else epoch,
    )


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

    1. If this operator's last beacon of the robot is newer than the report, the robot has failed.
    2. If another robot heard the robot within INDIRECT_TIME, the robot is alive and unreachable.
    3. Otherwise the robot has left, if so reported, or else has failed.
    """
    if heard is not None and (report is None or report.at <= heard.heard):
        report = PeerReport(heard.beacon.instance.hex(), Presence.FAILED, heard.heard)
    if report is None:
        return None
    presence, contact = report.presence, Contact.GONE
    if presence is Presence.ALIVE:
        is_recent = now - report.at <= INDIRECT_TIME
        presence = Presence.ALIVE if is_recent else Presence.FAILED
        contact = Contact.UNREACHABLE if is_recent else Contact.GONE
    return SeenMember(
        robot=robot,
        instance=report.instance,
        presence=presence,
        age=max(now - report.at, 0.0),
        status=answer.status if answer and isinstance(answer.status, Status) else None,
        contact=contact,
        by=report.by,
    )
