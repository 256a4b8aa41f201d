"""The marks by which ROS messages say that a field is not measured, for all message types. Pure.

An Imu whose orientation covariance begins with -1 is an example. The readers of IMU, battery,
odometry and of the entries of topic_entries.py use this table.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.typesys.base import normalize_fieldname

Rule = Callable[[Any, str, float], str]
"""Takes a message, a field and its value; returns why it is not measured, or an empty text."""


def why_absent(message: Any, field: str, value: float = math.nan) -> str:
    """Why the value of a field is not measured; empty if the field and its parents have no mark.

    `field`: names and indices separated by dots, such as `vector.x` or `data.0`. `value`: the value
    of the field; NaN if the field is no number.
    """
    node = message
    parts = field.split(".")
    for index, part in enumerate(parts):
        name = getattr(node, "__msgtype__", "").rpartition("/")[2]
        for kinds, rule in _RULES:
            if (not kinds or name in kinds) and (why := rule(node, part, value)):
                return why
        if index + 1 < len(parts):
            is_item = part.isdecimal()
            node = node[int(part)] if is_item else getattr(node, normalize_fieldname(part))
    return ""


def _covariance(message: Any, field: str, value: float) -> str:
    """A covariance whose first element is -1 (REP 145, sensor_msgs)."""
    if field == "covariance":
        return ""
    for name in (f"{field}_covariance", "covariance"):
        given = getattr(message, name, None)
        if isinstance(given, np.ndarray) and given.size and given[0] == -1.0:
            return f"its {name} begins with -1: {field} is not measured"
    return ""


def _variance(message: Any, field: str, value: float) -> str:
    variance = getattr(message, "variance", 0.0)  # 0: not known; a Range of Humble has none
    is_absent = field != "variance" and isinstance(variance, float) and variance < 0.0
    return f"its variance is {variance:g}: {field} is not measured" if is_absent else ""


def _battery(message: Any, field: str, value: float) -> str:
    """No battery, or no value. Many drivers never set `present`, so that a voltage counts, too."""
    if field == "present" or field.startswith("power_supply"):
        return ""
    if not (message.present or message.voltage > 0.0):  # true for NaN too
        return f"no battery is there (present: false, voltage {message.voltage:g} V)"
    if message.voltage == 0.0 == value:
        return f"{field} is 0 beside 0 V: nothing is measured yet"
    return ""


def _orientation(message: Any, field: str, value: float) -> str:
    is_empty = message.x == message.y == message.z == message.w == 0.0
    return "its orientation is all 0: it is not measured" if is_empty else ""


def _fix(message: Any, field: str, value: float) -> str:
    is_absent = field in ("latitude", "longitude", "altitude") and message.status.status < 0
    return f"it has no fix (status {message.status.status})" if is_absent else ""


def _range(message: Any, field: str, value: float) -> str:
    """A range outside the limits in its message (Range and LaserScan)."""
    if field not in ("range", "ranges") or not math.isfinite(value):
        return ""
    is_one = field == "range"
    low = message.min_range if is_one else message.range_min
    high = message.max_range if is_one else message.range_max
    if value == low == high == 0.0:
        return "0 m, and limits of 0 m: nothing is measured yet"
    if low < high and not low <= value <= high:
        return f"{value:.3g} m is outside its own limits of {low:.3g} to {high:.3g} m"
    return ""


def _box(message: Any, field: str, value: float) -> str:
    """A box with position and size 0, or a tag with all corners at 0."""
    if hasattr(message, "corners"):
        parts = [message.centre, *message.corners]
        is_empty = not any(part.x or part.y for part in parts)
    else:
        box = message.bbox
        at = getattr(box.center, "position", box.center)
        size = getattr(box, "size", None)
        sides = (box.size_x, box.size_y) if size is None else (size.x, size.y, size.z)
        is_empty = not any((at.x, at.y, getattr(at, "z", 0.0), *sides))
    return "its box is all 0: it has no place" if is_empty else ""


_RULES: tuple[tuple[tuple[str, ...], Rule], ...] = (
    ((), _covariance),
    ((), _variance),
    (("BatteryState",), _battery),
    (("Quaternion",), _orientation),
    (("NavSatFix",), _fix),
    (("Range", "LaserScan"), _range),
    (("Detection2D", "Detection3D", "AprilTagDetection"), _box),
)
"""Each rule with the short names of its message types; empty: all types."""
