"""`rclpy.qos`: the profiles of publishers and subscriptions. Depth and durability count here."""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import Any, cast


class ReliabilityPolicy(IntEnum):
    """Without effect: within a robot every message arrives."""

    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class DurabilityPolicy(IntEnum):
    """TRANSIENT_LOCAL: a later subscription gets the last messages, too."""

    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class HistoryPolicy(IntEnum):
    """KEEP_ALL: a subscription keeps up to MAX_DEPTH messages that wait."""

    SYSTEM_DEFAULT = 0
    KEEP_LAST = 1
    KEEP_ALL = 2
    UNKNOWN = 3


class LivelinessPolicy(IntEnum):
    """Without effect."""

    SYSTEM_DEFAULT = 0
    AUTOMATIC = 1
    MANUAL_BY_TOPIC = 3
    UNKNOWN = 4


MAX_DEPTH = 1000
"""Messages that may wait for one subscription."""


class QoSProfile:
    """As `rclpy.qos.QoSProfile`; further policies are kept and have no effect."""

    def __init__(self, **policies: Any) -> None:
        self.history = policies.get("history", HistoryPolicy.KEEP_LAST)
        self.depth = int(policies.get("depth", 10))
        self.reliability = policies.get("reliability", ReliabilityPolicy.RELIABLE)
        self.durability = policies.get("durability", DurabilityPolicy.VOLATILE)
        for name, value in policies.items():
            setattr(self, name, value)

    @property
    def kept(self) -> int:
        """How many messages may wait."""
        is_all = self.history == HistoryPolicy.KEEP_ALL
        return MAX_DEPTH if is_all else max(1, min(self.depth, MAX_DEPTH))

    @property
    def is_latched(self) -> bool:
        """Whether a later subscription gets the last messages."""
        return bool(self.durability == DurabilityPolicy.TRANSIENT_LOCAL)


def profile_of(given: Any) -> QoSProfile:
    """The profile that a node gives as a profile or as a depth."""
    if isinstance(given, QoSProfile):
        return given
    return QoSProfile(depth=10 if given is None else int(given))


def profiles() -> dict[str, QoSProfile]:
    """New objects of the profiles of `rclpy.qos`, by name."""
    best_effort = ReliabilityPolicy.BEST_EFFORT
    return {
        "qos_profile_sensor_data": QoSProfile(depth=5, reliability=best_effort),
        "qos_profile_system_default": QoSProfile(depth=10),
        "qos_profile_services_default": QoSProfile(depth=10),
        "qos_profile_parameters": QoSProfile(depth=1000),
        "qos_profile_parameter_events": QoSProfile(depth=1000),
        "qos_profile_action_status_default": QoSProfile(
            depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL
        ),
    }


def presets() -> type[Enum]:
    """`QoSPresetProfiles`: the same profiles as `profiles` gives, by the names of the presets."""
    made = profiles()
    named = {
        "UNKNOWN": QoSProfile(),
        "SYSTEM_DEFAULT": made["qos_profile_system_default"],
        "SENSOR_DATA": made["qos_profile_sensor_data"],
        "SERVICES_DEFAULT": made["qos_profile_services_default"],
        "PARAMETERS": made["qos_profile_parameters"],
        "PARAMETER_EVENTS": made["qos_profile_parameter_events"],
        "ACTION_STATUS_DEFAULT": made["qos_profile_action_status_default"],
    }
    return cast("type[Enum]", Enum("QoSPresetProfiles", named))
