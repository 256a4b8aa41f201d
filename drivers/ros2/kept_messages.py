"""The last messages of topics that are published on change, from the caches of their publishers.

A publisher with durability TRANSIENT_LOCAL is an advanced publisher of zenoh-ext, in the bridge
ros2dds 1.10 as in rmw_zenoh since 0.2.2: its cache answers to `<key>/@adv/**`. A publisher without
a cache does not answer. An advanced subscriber asks too, and drops what it had before: after a loss
of the link the last value would not come again, as it has to for a reading.
"""

from __future__ import annotations

from collections.abc import Callable

import zenoh
from zenoh.handlers import Callback

KEPT = ":kept"
"""Ends the name of a topic whose message comes from a cache."""

_TIMEOUT = 1.0


def query_kept(session: zenoh.Session, key: str, receive: Callable[[zenoh.Sample], None]) -> None:
    """Query the present publishers of a key. A newer message may arrive before the answer."""

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            receive(reply.ok)

    session.get(
        f"{key}/@adv/**?_max=1",
        Callback(on_reply, indirect=False),
        target=zenoh.QueryTarget.ALL,
        accept_replies=zenoh.ReplyKeyExpr.ANY,
        timeout=_TIMEOUT,
    )
