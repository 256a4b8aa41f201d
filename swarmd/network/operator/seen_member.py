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
    """A robot that is heard, or that answered. The status counts before the beacon."""
    status = answer.status if answer is not None else None
    at = now
    if answer is not None:
        at = answer.at
    elif heard is not None:
        at = heard.heard
    beacon = heard.beacon if heard is not None else None
    contact = Contact.ANSWERED if isinstance(status, Status) else Contact.NO_ANSWER
    if isinstance(status, StatusHeader) or (beacon and beacon.wire != codec.VERSION):
        contact = Contact.OTHER_VERSION
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
        age=max(now - at, 0.0),
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
    """A robot whose beacons do not arrive now; None for a robot that was never heard or reported.

    `report`: the most certain report of other robots. If this operator's last beacon of the robot
    is newer than the report, the robot has failed. If another robot heard the robot within
    INDIRECT_TIME, it is alive and unreachable. Otherwise it failed or left, as reported.
    """
    if heard is not None and (report is None or report.at <= heard.heard):
        report = PeerReport(heard.beacon.instance.hex(), Presence.FAILED, heard.heard)
    if report is None:
        return None
    is_alive = report.presence is Presence.ALIVE and now - report.at <= INDIRECT_TIME
    presence = Presence.FAILED if report.presence is Presence.ALIVE else report.presence
    return SeenMember(
        robot=robot,
        instance=report.instance,
        presence=Presence.ALIVE if is_alive else presence,
        age=max(now - report.at, 0.0),
        status=answer.status if answer and isinstance(answer.status, Status) else None,
        contact=Contact.UNREACHABLE if is_alive else Contact.GONE,
        by=report.by,
    )
