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
    """One end of a topic: a publisher or a subscription."""

    is_publisher: bool
    topic: str  # such as `/tb3_01/scan`
    type: str  # such as `sensor_msgs/msg/LaserScan`
    zid: str = ""  # the Zenoh session that announced it; empty in ROS 1
    domain: int | None = None  # None: not in the announcement
    node: str = ""  # empty: not in the announcement
    quality: str = ""  # of service, such as `reliable, transient local`; empty: not known
    process: str = ""  # the DDS participant of the node; empty where zid or node identify it
    since: float = -math.inf  # s on the driver's clock at which the node was first heard
    is_routed: bool = True  # False: a bridge lists the node, but does not route the topic

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
    """The announced endpoints, each replaced by the nodes that its bridge lists for the topic.

    A Zenoh bridge announces a topic once, with the type of the first node, whatever the number of
    nodes with the topic. Its admin space lists all nodes.

    Args:
        announced: the endpoints; an endpoint of rmw_zenoh, without a bridge, names its node.
        listed: an endpoint for each node that a bridge lists. The endpoint is not routed in the
            result if the bridge does not pass the topic on between DDS and Zenoh: the topic is not
            announced, or no listed node has the announced type.
        listed_at: s, the time of the list.
    """
    # By bridge, direction and topic.
    unannounced = defaultdict[tuple[str, bool, str], list[Endpoint]](list)
    for end in listed:
        unannounced[end.zid, end.is_publisher, end.topic].append(end)
    merged: list[Endpoint] = []
    for end in announced:
        if end.node:
            merged.append(end)
            continue
        nodes = unannounced.pop((end.zid, end.is_publisher, end.topic), [])
        # The nodes of an endpoint that was announced after the list may have left since.
        is_outdated = end.since > listed_at
        if is_outdated or not nodes:
            merged.append(end)
            continue
        is_routed = any(node.type == end.type for node in nodes)
        merged += [replace(node, quality=end.quality, is_routed=is_routed) for node in nodes]
    merged += [replace(end, is_routed=False) for ends in unannounced.values() for end in ends]
    return merged


def is_listener(node: str, more: Collection[str] = ()) -> bool:
    """True if a node subscribes to commands without being a base, by its name.

    Known names are in KNOWN_LISTENERS; `more`: further names or patterns of the options.
    """
    name = node.rpartition("/")[2]
    return any(fnmatchcase(name, known) for known in KNOWN_LISTENERS) or any(
        fnmatchcase(node if "/" in given else name, given) for given in more
    )


def nodes_of(ends: Iterable[Endpoint]) -> dict[tuple[str, str], Endpoint]:
    """The latest endpoint of each node, by process and node, sorted by the names of the nodes."""
    by_time = sorted(ends, key=lambda end: end.since)
    latest = {end.source: end for end in by_time}
    return dict(sorted(latest.items(), key=lambda item: (item[1].owner, item[0])))
