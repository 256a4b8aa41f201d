"""The session to a robot's hub: a client, since only a client's data pass a Zenoh router.

Two peers at one router exchange nothing (Zenoh 1.10), and every node of rmw_zenoh is a peer. A
client reconnects by itself once it was open; opening fails while nothing listens.
"""

from __future__ import annotations

import contextlib

import zenoh

from swarmd.core.errors import NetworkError
from swarmd.network.session import PROMPT_OPTIONS, open_with, realtime_publisher, tune_sockets

LINK_TIMEOUT = 5.0
"""Seconds without an acknowledgement after which a link is given up and dialled again."""


def open_session(endpoint: str, *, within: float = 1.0) -> zenoh.Session | None:
    """A session to the hub at `endpoint`; None if the hub does not answer within that time in s."""
    options: dict[str, object] = {
        **PROMPT_OPTIONS,
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": round(within * 1000),
        "connect/retry": {
            "period_init_ms": 200,
            "period_max_ms": 500,
            "period_increase_factor": 1.5,
        },
    }
    try:
        session = open_with(options, what=endpoint)
    except NetworkError:
        return None
    tune_sockets(session, LINK_TIMEOUT)
    return session


def linked_hubs(session: zenoh.Session) -> frozenset[str]:
    """The ids of the hubs it is linked to, new at each start of a hub; empty without a link."""
    with contextlib.suppress(zenoh.ZError):
        return frozenset(map(str, (*session.info.routers_zid(), *session.info.peers_zid())))
    return frozenset()


def command_publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """A publisher of commands; it skips its own session."""
    return realtime_publisher(session, key, allowed_destination=zenoh.Locality.REMOTE)
