"""The last messages of topics that are published on change, from the caches of their publishers.

A publisher with durability TRANSIENT_LOCAL is an advanced publisher of zenoh-ext, in the bridge
ros2dds 1.10 as in rmw_zenoh since 0.2.2: its cache answers to `<key>/@adv/**`. A publisher without
a cache does not answer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import zenoh
from zenoh.handlers import Callback

from swarmd.drivers.ros.topic_stats import TopicStats
from swarmd.drivers.ros2.key_scheme import KeyScheme

KEPT = ":kept"
"""Ends the name of a topic whose message comes from a cache."""

_TIMEOUT = 1.0


class KeptMessages:
    """Queries for the last message of topics that are published on change.

    `topics`: by full name. `put(name, payload)` takes the answers, on any thread.
    """

    def __init__(
        self,
        scheme: KeyScheme,
        topics: Mapping[str, TopicStats],
        put: Callable[[str, bytes], None],
    ) -> None:
        self._scheme, self._topics, self._put = scheme, topics, put

    def __contains__(self, topic: str) -> bool:
        return topic in self._topics

    def query(self, session: zenoh.Session, topic: str) -> None:
        """Query the present publishers. A newer message may arrive before the answer."""
        stats, scheme, put = self._topics[topic], self._scheme, self._put

        def on_reply(reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is not None and not scheme.key_fault(
                str(sample.key_expr), topic, stats.message_type
            ):
                put(f"{stats.name}{KEPT}", sample.payload.to_bytes())

        session.get(
            f"{scheme.subscription_key(topic)}/@adv/**?_max=1",
            Callback(on_reply, indirect=False),
            target=zenoh.QueryTarget.ALL,
            accept_replies=zenoh.ReplyKeyExpr.ANY,
            timeout=_TIMEOUT,
        )
