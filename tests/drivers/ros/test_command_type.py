"""The type of commands, by the option and by the base."""

from __future__ import annotations

from collections.abc import Collection

import pytest

from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.command_type import Option, allowed_types, wanted_type
from swarmd.drivers.ros.messages import Twist, TwistStamped

TWIST, STAMPED = name_of(Twist), name_of(TwistStamped)


@pytest.mark.parametrize(
    ("option", "of_bases", "wanted"),
    [
        ("auto", (TWIST,), Twist),
        ("auto", (STAMPED,), TwistStamped),
        ("auto", (STAMPED, "sensor_msgs/msg/Imu"), TwistStamped),
        ("auto", (), None),
        ("auto", (TWIST, STAMPED), None),
        ("twist", (), Twist),
        ("twist_stamped", (TWIST,), TwistStamped),
    ],
)
def test_a_base_decides_where_the_option_leaves_both(
    option: Option, of_bases: Collection[str], wanted: type | None
) -> None:
    assert wanted_type(allowed_types(option), of_bases, name_of) is wanted
