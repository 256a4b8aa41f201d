"""Publishers and subscriptions of topics, the nodes that have them, and listeners. Pure."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

KNOWN_LISTENERS = (
    "rosbag2_recorder*",
    "record_[0-9]*",
    "_ros2cli*",
    "rostopic_[0-9]*",
    "rviz*",
    "rqt*",
    "foxglove_bridge*",
    "swarmd",
    "swarmd_*",
)
"""Names of nodes that take commands to record, show or count them: tools, and daemons."""


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One end of a topic: a publisher or a subscription.

    `topic` such as `/tb3_01/scan`, `type` such as `sensor_msgs/msg/LaserScan`; `domain` is None and
    `node` empty where the announcement does not tell them. `zid` is the Zenoh session that
    announced it; empty in ROS 1. `quality` of service, such as `best effort`, or `reliable,
    transient local`; empty where it is unknown. `process` identifies the node's process: a DDS
    participant; empty where the session, or the name, does that. `since`: when the driver first
    heard of the node, in s on its clock. `is_routed` False: a bridge lists the node, but hands
    nothing on.
    """

    is_publisher: bool
    topic: str
    type: str
    zid: str = ""
    domain: int | None = None
    node: str = ""
    quality: str = ""
    process: str = ""
    since: float = -math.inf
    is_routed: bool = True

    @property
    def owner(self) -> str:
        """The node; without one, the bridge that announces the endpoint."""
        return self.node or f"a node behind bridge {self.zid[:8]}"

    @property
    def source(self) -> tuple[str, str]:
        """The process and the node: equal for all ends of one node, however often it is listed."""
        return self.process or self.zid, self.node


def with_nodes(
    announced: Iterable[Endpoint], listed: Iterable[Endpoint], listed_at: float
) -> list[Endpoint]:
    """The announced endpoints, one for each node that a bridge lists behind it.

    A bridge announces a topic once, however many nodes have it, and with the type of the first one.
    An endpoint without a listed node stays as it is. So does an endpoint that was announced after
    `listed_at`, the time of the list: the list has the types of nodes that may have left. What is
    listed and not announced is not routed, nor are nodes of which none has the announced type.
    """
    nodes = defaultdict[tuple[str, bool, str], list[Endpoint]](list)
    for end in listed:
        nodes[end.zid, end.is_publisher, end.topic].append(end)
    found: list[Endpoint] = []
    for end in announced:
        key = end.zid, end.is_publisher, end.topic
        behind = [] if end.node else nodes.pop(key, [])
        behind = behind if end.since <= listed_at else []
        is_routed = any(one.type == end.type for one in behind)
        found += [replace(one, quality=end.quality, is_routed=is_routed) for one in behind] or [end]
    found += [replace(end, is_routed=False) for ends in nodes.values() for end in ends]
    return found


def is_listener(node: str, more: Collection[str] = ()) -> bool:
    """True if a node takes commands without moving anything, by its name or a pattern in `more`."""
    name = node.rpartition("/")[2]
    return any(fnmatchcase(name, known) for known in KNOWN_LISTENERS) or any(
        fnmatchcase(node if "/" in given else name, given) for given in more
    )


def nodes_of(ends: Iterable[Endpoint]) -> dict[tuple[str, str], Endpoint]:
    """One endpoint for each node, in the order of the names; of two that are alike the latest."""
    latest = sorted(ends, key=lambda end: end.since)
    found = {end.source: end for end in latest}
    return dict(sorted(found.items(), key=lambda item: (item[1].owner, item[0])))
