"""Nodes that crashed and are back under their name, as a zenoh-bridge-ros2dds knows them.

DDS takes a process that was killed for alive for 10 s, or as long as its lease. When that is over
the bridge (1.10, its issue 702) takes back what it announced of every node of that name, for good:
a base that is back by then no longer hears a command, not even zero. It is told in time here.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping

import zenoh

PERIOD = 2.0
"""Seconds between two rounds."""

_MOST = 1024
_LONGEST = 100_000
_WITHIN = 1.0


class DuplicateNodes:
    """Asks a bridge for its nodes, round after round.

    `twin` is a node that listens to the topic and is there twice, as `/base`; empty if none is.
    """

    def __init__(self, selector: str, topic: str) -> None:
        """`selector`: where a bridge tells of its nodes; none is asked if that is empty."""
        self._selector, self._topic = selector, topic
        self._known: dict[str, bytes] = {}
        self._begun = -math.inf
        self.twin = ""

    def look(self, session: zenoh.Session, now: float) -> None:
        """Begin a new round if it is time, and go by what the last one has brought."""
        if not self._selector or now - self._begun < PERIOD:
            return
        self._begun, self.twin = now, twin_of(self._known.copy(), self._topic)
        known: dict[str, bytes] = {}
        self._known = known

        def on_reply(reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is not None and len(known) < _MOST and len(sample.payload) <= _LONGEST:
                known[str(sample.key_expr)] = sample.payload.to_bytes()

        session.get(self._selector, on_reply, timeout=_WITHIN)


def twin_of(known: Mapping[str, bytes], topic: str) -> str:
    """Which node that listens to the topic has two participants; empty if none.

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
        # A bridge's namespace stands before the topic, but not in what it tells of its nodes.
        return any(topic.endswith(one["name"]) for one in heard)
    except (ValueError, KeyError, TypeError, RecursionError):
        return False
