"""Robots behind a zenoh-bridge-ros2dds, for daemons with driver `ros2dds`.

Announcements as in eclipse-zenoh/zenoh-plugin-ros2dds, `liveliness_mgt.rs`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from swarmd.core.values import Platform
from swarmd.driver_api.emulator import OnCommand
from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros2.dds_bridge import NAME
from swarmd.drivers.ros2.emulator import End, Language, RosRobots

_BEST_EFFORT = ":0::0,5"
_RELIABLE = ":1::0,10"


def make_robots(
    *, robots: Mapping[str, Platform], endpoint: str, on_command: OnCommand
) -> RosRobots:
    """Robots, each in a namespace of its own, at one bridge that listens at `endpoint`."""
    language = Language(NAME, RosOptions, lambda options, index: BridgedVoice())
    return RosRobots(language, robots, endpoint, on_command)


class BridgedVoice:
    """What a bridge makes of a robot's topics."""

    def key(self, topic: str, kind: type) -> str:
        """The topic without its first slash."""
        return topic.removeprefix("/")

    def announce(self, zid: str, ends: Sequence[End]) -> tuple[Sequence[str], Sequence[str]]:
        """`@/<zid>/@ros2_lv/{MP|MS}/<key>/<type>/<qos>`, with § for slashes; none of a node."""
        return (), tuple(self._token(zid, end) for end in ends)

    def attachment(self, token: str) -> bytes | None:
        """None: a bridge sends the payload alone."""
        return None

    def _token(self, zid: str, end: End) -> str:
        key, kind = (
            text.replace("/", "§") for text in (self.key(end.topic, end.kind), name_of(end.kind))
        )
        what = "MP" if end.is_publisher else "MS"
        qos = _BEST_EFFORT if end.is_sensor else _RELIABLE
        return f"@/{zid}/@ros2_lv/{what}/{key}/{kind}/{qos}"
