"""Chooses the message class of commands, Twist or TwistStamped. Pure.

The option `cmd_vel_type` decides, or the type to which the base subscribes. In ROS 1 the adapter
process asks the base's node for this type. `from_ros.py` makes the message.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Literal

from swarmd.drivers.ros import messages

Option = Literal["auto", "twist", "twist_stamped"]
"""`auto`: the type to which the base subscribes."""


def allowed_types(option: Option) -> tuple[type, ...]:
    """The message classes that commands may have: one, or both if the base decides."""
    if option == "twist":
        return (messages.Twist,)
    if option == "twist_stamped":
        return (messages.TwistStamped,)
    return messages.Twist, messages.TwistStamped


def wanted_type(
    allowed: Sequence[type], of_bases: Collection[str], type_name: Callable[[type], str]
) -> type | None:
    """The message class of commands; None if it is not known, or bases want different classes.

    `of_bases`: the names of the types to which bases subscribe, as `type_name` writes them. A
    single class in `allowed` is returned without asking for bases.
    """
    if len(allowed) == 1:
        return allowed[0]
    wanted = [kind for kind in allowed if type_name(kind) in of_bases]
    return wanted[0] if len(wanted) == 1 else None
