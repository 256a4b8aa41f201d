"""Nodes that crashed and restarted under their name, as a zenoh-bridge-ros2dds knows them.

DDS counts a killed process as alive for the time of its lease, 10 s by default. At the lease's end
the bridge (1.10, its issue 702) withdraws the announcements of every node of that name, for good: a
base that restarted meanwhile no longer receives commands, not even zero. The driver finds the
duplicate in time and stops the base.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping

import zenoh

PERIOD = 2.0
"""Seconds between two queries."""

_MAX_NODES = 1024
_MAX_PAYLOAD = 100_000
_QUERY_TIMEOUT = 1.0


class DuplicateNodes:
    """Queries a bridge for its nodes, again and again.

    `duplicate` is a node that subscribes to the topic and is listed twice, such as `/base`; empty
    without one.
    """

    def __init__(self, selector: str, topic: str) -> None:
        """`selector`: of a bridge's answers about its nodes; empty where there is no bridge."""
        self._selector, self._topic = selector, topic
        self._known: dict[str, bytes] = {}
        self._begun = -math.inf
        self.duplicate = ""

    def query(self, session: zenoh.Session, now: float) -> None:
        """Query again each PERIOD, and evaluate the answers to the query before."""
        if not self._selector or now - self._begun < PERIOD:
            return
        self._begun, self.duplicate = now, duplicate_of(self._known.copy(), self._topic)
        known: dict[str, bytes] = {}
        self._known = known

        def on_reply(reply: zenoh.Reply) -> None:
            sample = reply.ok
            if (
                sample is not None
                and len(known) < _MAX_NODES
                and len(sample.payload) <= _MAX_PAYLOAD
            ):
                known[str(sample.key_expr)] = sample.payload.to_bytes()

        session.get(self._selector, on_reply, timeout=_QUERY_TIMEOUT)


def duplicate_of(known: Mapping[str, bytes], topic: str) -> str:
    """The node that subscribes to the topic and has two participants; empty without one.

    Keys are `@/<zid>/ros2/node/<participant>/<name>`, each with the node's topics as JSON.
    """
    named = Counter(map(_named, known))
    takers = Counter(
        _named(key)
        for key, payload in known.items()
        if named[_named(key)] > 1 and _takes(payload, topic)
    )
    return next((name for (_, name), count in sorted(takers.items()) if count > 1), "")


def _named(key: str) -> tuple[str, str]:
    parts = key.split("/")
    return "/".join(parts[:4]), "/" + "/".join(parts[5:])


def _takes(payload: bytes, topic: str) -> bool:
    try:
        heard = json.loads(payload)["subscribers"]
        # A bridge's namespace stands before the topic, but not in its answers about nodes.
        return any(topic.endswith(one["name"]) for one in heard)
    except (ValueError, KeyError, TypeError, RecursionError):
        return False
