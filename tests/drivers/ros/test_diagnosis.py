"""What `swarmd --check` says of what was heard: pure; over Zenoh: `test_ros2dds.py`."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from swarmd.driver_api.driver import Finding
from swarmd.drivers.ros import messages
from swarmd.drivers.ros.diagnosis import Report, has_enough
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros.topic_stats import Sense
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.drivers.ros2.key_scheme import Endpoint
from swarmd.drivers.ros2.subscriptions import Subscriptions
from tests.drivers.ros2 import robots

TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"


def hearing(scans: Iterable[tuple[float, float]], odometries: int = 5) -> Subscriptions:
    """Scans with these arrivals and stamps."""
    made = Subscriptions(RosOptions(), robots.PLATFORM)
    for now, stamp in scans:
        made.take("scan", robots.scan(stamp).serialize(), now)
    for count in range(odometries):
        made.take("odometry", robots.odometry(0.1 * count).serialize(), 0.1 * count)
    return made


WELL = [(0.2 * i, 50.0 + 0.2 * i) for i in range(6)]


def found(
    heard: Subscriptions, graph: Iterable[Endpoint] = (), *, has_taker: bool = True, others: int = 0
) -> dict[str, Finding]:
    report = Report(
        scheme=Ros2Dds(),
        endpoint="tcp/127.0.0.1:7447",
        is_connected=True,
        hearing=heard,
        spec=robots.PLATFORM.scan,
        graph=list(graph),
        cmd_vel="/cmd_vel",
        command=messages.Twist,
        has_taker=has_taker,
        others=others,
    )
    return {finding.subject: finding for finding in report.findings()}


def end(kind: str, *, says: bool, topic: str = "/cmd_vel") -> Endpoint:
    return Endpoint(says, topic, kind, "abc", node="/teleop")


def test_all_is_well_where_all_is_there() -> None:
    well = found(hearing(WELL))
    assert all(finding.is_well for finding in well.values())
    assert "5.0 Hz, 360 rays, stamps went on 1.0 s in 1.0 s" in well["scan"].text


@pytest.mark.parametrize(
    ("scans", "said"),
    [
        ([(0.2 * i, 5.0) for i in range(6)], "all with the stamp 5;"),
        ([(0.2 * i, 1763711479.5) for i in range(6)], "all with the stamp 1763711479.5;"),
        ([(0.5 * i, 0.5 * i) for i in range(6)], "comes at 2.0 Hz; the platform's scan.rate is 5"),
        ([], "announces no topic at all"),
    ],
)
def test_scans_that_cannot_be_driven_on_are_told(
    scans: list[tuple[float, float]], said: str
) -> None:
    scan = found(hearing(scans))["scan"]
    assert not scan.is_well
    assert said in scan.text


def test_who_else_commands_is_told_from_who_only_could() -> None:
    assert not found(hearing(WELL), others=1)["others"].is_well
    could = found(hearing(WELL), [end(TWIST, says=True)])["others"]
    assert could.is_well
    assert "/teleop may publish /cmd_vel too" in could.text


def test_a_base_that_takes_another_type_or_is_not_there_is_told() -> None:
    other = found(hearing(WELL), [end(STAMPED, says=False)])["cmd_vel"]
    assert not other.is_well
    assert "set driver_options.cmd_vel_type: twist_stamped" in other.text
    nobody = found(hearing(WELL), [end(TWIST, says=True)], has_taker=False)["cmd_vel"]
    assert not nobody.is_well
    assert "nobody subscribes to /cmd_vel" in nobody.text
    assert found(hearing(WELL), [end(TWIST, says=False)], has_taker=False)["cmd_vel"].is_well


def test_it_has_enough_after_5_messages_of_what_is_needed_and_a_second() -> None:
    assert has_enough(hearing(WELL), 1.0)
    assert not has_enough(hearing(WELL), 0.99)
    assert not has_enough(hearing(WELL[:4]), 5.0)


def sense() -> Sense:
    return Sense("scan", "scan", "/scan", messages.LaserScan)


def test_a_rate_is_that_of_the_gaps() -> None:
    made = sense()
    made.hear(1.0, 1.0)
    assert made.rate() == 0.0
    for now in (1.25, 1.5):
        made.hear(now, now)
    assert made.rate() == 4.0


def test_a_complaint_lasts_2_s() -> None:
    made = sense()
    made.complain(1.0, "rubbish")
    assert (made.complaint(2.99), made.complaint(3.0)) == ("rubbish", "")


def test_stamps_advance_only_if_the_last_is_later() -> None:
    made = sense()
    for stamp in (5.0, 5.0):
        made.hear(stamp, stamp)
    assert made.advances(), "too few to tell"
    made.hear(6.0, 5.0)
    assert not made.advances()
    made.hear(7.0, 5.5)
    assert made.advances()
