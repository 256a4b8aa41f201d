"""The session to a robot's hub: a client, since only a client is heard beyond a Zenoh router.

Two peers around one router do not hear each other (Zenoh 1.10), and every node of rmw_zenoh is a
peer. A client finds its way back by itself after a first opening, which fails while nothing is
there.
"""

from __future__ import annotations

import contextlib

import zenoh

from swarmd.core.errors import NetworkError
from swarmd.network.session import open_with, tune_sockets

CUT_AFTER = 5.0
"""Seconds without an acknowledgement after which a link is given up and dialled anew."""


def open_session(endpoint: str, *, within: float = 1.0) -> zenoh.Session | None:
    """A session to what listens at `endpoint`; None if nothing does, within that many seconds."""
    options: dict[str, object] = {
        "mode": "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": round(within * 1000),
        "connect/retry": {
            "period_init_ms": 200,
            "period_max_ms": 500,
            "period_increase_factor": 1.5,
        },
        # Sending never waits; without room for a burst the newest would be dropped: a zero.
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
        "transport/link/tx/queue/size/real_time": 16,
        "transport/shared_memory/enabled": False,
    }
    try:
        session = open_with(options, what=endpoint)
    except NetworkError:
        return None
    tune_sockets(session, CUT_AFTER)
    return session


def hubs_of(session: zenoh.Session) -> frozenset[str]:
    """Whom it is linked to, by an id that is new at each start; empty while to nobody."""
    with contextlib.suppress(zenoh.ZError):
        return frozenset(map(str, (*session.info.routers_zid(), *session.info.peers_zid())))
    return frozenset()


def commanding(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """A publisher that never waits, goes before everything else, and is not heard by itself."""
    return session.declare_publisher(
        key,
        allowed_destination=zenoh.Locality.REMOTE,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.REAL_TIME,
        express=True,
    )


def has_subscriber(publisher: zenoh.Publisher) -> bool:
    """Whether anyone else listens to what it says."""
    # The stubs call it a bool; it is an object with that attribute.
    return bool(getattr(publisher.matching_status, "matching", False))
