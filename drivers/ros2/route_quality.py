"""Nodes whose messages a zenoh-bridge-ros2dds does not pass on, by their quality of service. Pure.

The bridge (1.10) makes one route for a topic, with the quality of service of the first node that it
finds, and keeps it while any node has the topic. A node that comes later and asks for more, or that
offers less, is connected to nothing, and neither DDS nor the bridge says so.
"""

from __future__ import annotations

from collections.abc import Iterable

from swarmd.drivers.ros.diagnosis import Graph
from swarmd.drivers.ros.endpoints import Endpoint


def route_faults(ends: Iterable[Endpoint], graph: Graph) -> dict[str, str]:
    """By topic, why messages of these ends in DDS do not pass the bridge."""
    found: dict[str, str] = {}
    for end in ends:
        routes = graph.qualities(end.topic, is_publisher=end.is_publisher)
        differs = _differs(end, routes[0]) if len(routes) == 1 else ""
        if differs and end.topic not in found:
            does, hub = "publishes" if end.is_publisher else "takes", graph.middleware.hub
            found[end.topic] = (
                f"a node {does} {end.topic} {differs}, but {hub} has a {routes[0]} route, as the"
                f" first node of that topic was: nothing passes; start {hub} again when the other"
                " node has ended"
            )
    return found


def _differs(end: Endpoint, route: str) -> str:
    """What an end of DDS offers too little, or asks for in vain; empty if its messages pass."""
    is_kept = "transient" in end.quality
    if not end.is_publisher:
        return "transient local" if is_kept and "transient" not in route else ""
    if route.startswith("reliable") and not end.quality.startswith("reliable"):
        return "best effort"
    return "volatile" if "transient" in route and not is_kept else ""
