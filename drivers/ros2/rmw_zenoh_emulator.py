"""Robots whose nodes speak rmw_zenoh, for daemons with driver `rmw_zenoh`.

Keys, attachments and tokens as in rmw_zenoh's `docs/design.md`; hashes are Jazzy's.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from swarmd.core.values import Platform
from swarmd.driver_api.emulator import OnCommand
from swarmd.drivers.ros.cdr import name_of, type_hash
from swarmd.drivers.ros.messages import dds_name
from swarmd.drivers.ros.options import RmwOptions, RosOptions
from swarmd.drivers.ros2.emulator import End, Language, RosRobots
from swarmd.drivers.ros2.rmw_zenoh import NAME, attachment_of, gid_of

_NODE = "base"
_BEST_EFFORT = "2::,5:,:,:,,"
_RELIABLE = "::,10:,:,:,,"


def make_robots(
    *, robots: Mapping[str, Platform], endpoint: str, on_command: OnCommand
) -> RosRobots:
    """Robots, each a node in a namespace of its own, at one rmw_zenohd that is at `endpoint`."""
    return RosRobots(Language(NAME, RmwOptions, _voice), robots, endpoint, on_command)


def _voice(options: RosOptions, index: int) -> NodeVoice:
    assert isinstance(options, RmwOptions)
    return NodeVoice(options.domain, options.namespace, index)


class NodeVoice:
    """One node: `index` is its number in the session that all of them share."""

    def __init__(self, domain: int, namespace: str, index: int) -> None:
        self._domain, self._namespace, self._index = domain, f"/{namespace.strip('/')}", index
        self._said: Counter[str] = Counter()
        self._gids: dict[str, bytes] = {}

    def key(self, topic: str, kind: type) -> str:
        """`<domain>/<topic>/<type>/<hash>`."""
        return f"{self._domain}{topic}/{dds_name(name_of(kind))}/{type_hash(kind)}"

    def announce(self, zid: str, ends: Sequence[End]) -> tuple[Sequence[str], Sequence[str]]:
        """The node's token, and one for each of its ends."""
        first = self._index * 100
        context = f"@ros2_lv/{self._domain}/{zid}/{self._index}"
        whose = f"%/{_mangled(self._namespace)}/{_NODE}"
        tokens = []
        for number, end in enumerate(ends, start=first + 1):
            what = "MP" if end.is_publisher else "MS"
            kind, qos = dds_name(name_of(end.kind)), _BEST_EFFORT if end.is_sensor else _RELIABLE
            tokens.append(
                f"{context}/{number}/{what}/{whose}/{_mangled(end.topic)}/{kind}"
                f"/{type_hash(end.kind)}/{qos}"
            )
        self._gids = {token: gid_of(token) for token in tokens}
        return (f"{context}/{first}/NN/{whose}",), tuple(tokens)

    def attachment(self, token: str) -> bytes | None:
        """The publisher's sequence number, the time and its gid."""
        self._said[token] += 1
        return attachment_of(self._said[token], self._gids[token])


def _mangled(name: str) -> str:
    return name.replace("/", "%")
