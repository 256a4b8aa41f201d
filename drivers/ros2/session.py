"""The session to a robot's hub: a client, since only a client's data pass a Zenoh router.

Two peers at one router exchange nothing (Zenoh 1.10), and every node of rmw_zenoh is a peer. A
client reconnects by itself once it was open; opening fails while nothing listens.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import zenoh
import zenoh.ext
from zenoh.handlers import Callback

from swarmd.core.errors import NetworkError
from swarmd.network.carriers.session import (
    PROMPT_OPTIONS,
    open_with,
    realtime_publisher,
    tune_sockets,
)

LINK_TIMEOUT = 5.0
"""Seconds without an acknowledgement after which a link is given up and dialled again."""

OPEN_TIME = 1.0
"""Seconds for the first attempt to open a session: a hub that is near answers within them."""

MAX_OPEN_TIME = 2.5
"""Seconds for each further attempt: opening takes three round trips, and a link may be slow."""

_NO_TOKEN = "@swarmd/alive"
_ANSWER_TIMEOUT = 5.0
_KEPT_TIMEOUT = 1.0
KEPT = ":kept"
"""Ends the name of a topic whose message comes from a cache."""


def open_session(endpoint: str, *, within: float = OPEN_TIME) -> zenoh.Session | None:
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


def ask_hub(session: zenoh.Session, on_answer: Callable[[], object]) -> None:
    """Call `on_answer` on a thread of Zenoh once the hub has answered; never if it does not.

    The question is for tokens that do not exist, which a hub answers by itself: 0.4 ms on loopback.
    """
    errors: list[zenoh.Reply] = []  # the timeout; there is no such token

    def on_end() -> None:
        if not errors:
            on_answer()

    session.liveliness().get(
        _NO_TOKEN, Callback(errors.append, on_end, indirect=False), timeout=_ANSWER_TIMEOUT
    )


def subscribe_with_history(
    session: zenoh.Session, key: str, receive: Callable[[zenoh.Sample], None]
) -> None:
    """Subscribe also to what the publishers keep for late subscribers, in the order of publication.

    A bridge hands on what a DDS writer keeps to the first subscriber only; to later ones from its
    own cache.
    """
    zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        receive,
        allowed_origin=zenoh.Locality.REMOTE,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
    )


def command_publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """A publisher of commands; it skips its own session."""
    return realtime_publisher(session, key, allowed_destination=zenoh.Locality.REMOTE)


def query_kept(session: zenoh.Session, key: str, receive: Callable[[zenoh.Sample], None]) -> None:
    """Query the publishers of a key for their last message; a newer one may arrive before it.

    A publisher with durability TRANSIENT_LOCAL is an advanced publisher of zenoh-ext, in the bridge
    ros2dds 1.10 as in rmw_zenoh since 0.2.2: its cache answers to `<key>/@adv/**`. Other publishers
    do not answer. An advanced subscriber asks too, and drops what it had before: after a loss of
    the link the last value would not come again, as it has to for a reading.
    """

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            receive(reply.ok)

    session.get(
        f"{key}/@adv/**?_max=1",
        Callback(on_reply, indirect=False),
        target=zenoh.QueryTarget.ALL,
        accept_replies=zenoh.ReplyKeyExpr.ANY,
        timeout=_KEPT_TIMEOUT,
    )
