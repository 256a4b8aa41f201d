"""Nodes whose messages a zenoh-bridge-ros2dds does not pass on, by their quality of service.

The bridge (1.10) makes one route for a topic, with the quality of service of the first node that it
finds, and keeps it while any node has the topic. A node that comes later and asks for more, or that
offers less, is connected to nothing, and neither DDS nor the bridge says so.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Mapping

import zenoh

from swarmd.drivers.ros.diagnosis import Graph

PERIOD = 2.0
"""Seconds between two queries."""

_MAX_ENDS, _MAX_PAYLOAD = 256, 100_000
_QUERY_TIMEOUT = 1.0


class RouteQualities:
    """Queries a bridge for the ends in DDS of some topics, again and again."""

    def __init__(self, selector: str, sensed: Iterable[str], cmd_vel: str) -> None:
        """`selector`: of a bridge's answers about DDS; empty where there is no bridge.

        `sensed` are the topics that the robot publishes, `cmd_vel` is that of its commands.
        """
        self._selector = selector
        self._topics = {**dict.fromkeys(sensed, True), cmd_vel: False} if selector else {}
        self._known: dict[str, bytes] = {}
        self._before: Mapping[str, bytes] = {}
        self._begun = -math.inf

    def query(self, session: zenoh.Session, now: float) -> None:
        """Query again each PERIOD; the answers to the query before count from then on."""
        if now - self._begun < PERIOD:
            return
        self._begun, self._before = now, self._known
        known: dict[str, bytes] = {}
        self._known = known

        def on_reply(reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample and len(known) < _MAX_ENDS and len(sample.payload) <= _MAX_PAYLOAD:
                known[str(sample.key_expr)] = sample.payload.to_bytes()

        for name in {topic.rpartition("/")[2] for topic in self._topics}:
            session.get(f"{self._selector}/rt/**/{name}", on_reply, timeout=_QUERY_TIMEOUT)

    def faults(self, graph: Graph) -> dict[str, str]:
        """Why messages of a topic do not pass the bridge, for each topic where that is known."""
        ends = {**self._before, **self._known.copy()}.values()
        found = {
            topic: route_fault(ends, graph, topic, is_publisher=is_publisher)
            for topic, is_publisher in self._topics.items()
        }
        return {topic: fault for topic, fault in found.items() if fault}


def route_fault(ends: Collection[bytes], graph: Graph, topic: str, *, is_publisher: bool) -> str:
    """The fault of a route by what the bridge tells of the ends in DDS, each as JSON.

    `is_publisher`: of a topic that the robot publishes; else of one to which it subscribes.
    """
    routes = graph.qualities(topic, is_publisher=is_publisher)
    if len(routes) != 1:
        return ""
    (route,), hub = routes, graph.middleware.hub
    for end in ends:
        differs = _differs(end, route, topic, is_publisher=is_publisher)
        if differs:
            does = "publishes" if is_publisher else "takes"
            return (
                f"a node {does} {topic} {differs}, but {hub} has a {route} route, as the first node"
                f" of that topic was: nothing passes; start {hub} again when the other node has"
                " ended"
            )
    return ""


def _differs(end: bytes, route: str, topic: str, *, is_publisher: bool) -> str:
    """What an end of DDS offers too little, or asks for in vain; empty if its messages pass."""
    try:
        read = json.loads(end)
        name, qos = str(read["topic_name"]), read["qos"]
        is_reliable = qos.get("reliability", {}).get("kind") != "BEST_EFFORT"
        is_kept = qos.get("durability", {}).get("kind") == "TRANSIENT_LOCAL"
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return ""
    # A bridge's namespace stands before the topic, but not in what it tells of DDS.
    if not name.startswith("rt/") or not topic.endswith(name.removeprefix("rt")):
        return ""
    if not is_publisher:
        return "transient local" if is_kept and "transient" not in route else ""
    if route.startswith("reliable") and not is_reliable:
        return "best effort"
    return "volatile" if "transient" in route and not is_kept else ""
