"""The Zenoh session to a robot's hub, in client mode, and its publishers and queries.

The hub is a Zenoh router or bridge. A Zenoh router (1.10) passes no data between two peers, and
every node of rmw_zenoh is a peer: the driver must be a client. Opening a session fails while the
hub does not listen. An open client session reconnects by itself.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import zenoh
import zenoh.ext
from zenoh.handlers import Callback

from swarmd.core.errors import NetworkError
from swarmd.link.carriers.session import (
    PROMPT_OPTIONS,
    open_with,
    realtime_publisher,
    tune_sockets,
)

LINK_TIMEOUT = 5.0
"""Seconds without an acknowledgement after which a link is given up and dialled again."""

OPEN_TIME = 1.0
"""Seconds for the first attempt to open a session: a hub on a fast link answers within them."""

MAX_OPEN_TIME = 2.5
"""Seconds for each further attempt: opening takes three round trips, and a link may be slow."""

_NO_TOKEN = "@swarmd/alive"
_ANSWER_TIMEOUT = 5.0
_KEPT_TIMEOUT = 1.0
KEPT = ":kept"
"""Suffix of a topic's name for a message from a publisher's cache."""


def open_session(endpoint: str, *, within: float = OPEN_TIME) -> zenoh.Session | None:
    """A session to the hub at `endpoint`; None if the hub does not answer within `within` s."""
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
    """The ids of the hubs to which the session is linked; a hub has a new id at each start."""
    with contextlib.suppress(zenoh.ZError):
        return frozenset(map(str, (*session.info.routers_zid(), *session.info.peers_zid())))
    return frozenset()


def ask_hub(session: zenoh.Session, on_answer: Callable[[], object]) -> None:
    """Call `on_answer` on a thread of Zenoh once the hub has answered; not called on a timeout.

    The query is for a liveliness token that does not exist. The hub itself answers that there is
    no such token, within 0.4 ms on loopback. Without a link to a hub `on_answer` is called at once.
    """
    errors: list[zenoh.Reply] = []  # the only possible reply is the error of a timeout

    def on_end() -> None:
        if not errors:
            on_answer()

    session.liveliness().get(
        _NO_TOKEN, Callback(errors.append, on_end, indirect=False), timeout=_ANSWER_TIMEOUT
    )


def subscribe_with_history(
    session: zenoh.Session, key: str, receive: Callable[[zenoh.Sample], None]
) -> None:
    """Subscribe, and also receive the last message that publishers keep for late subscribers.

    Messages come in order. A DDS writer may keep messages for late subscribers (TRANSIENT_LOCAL). A
    bridge sends the kept messages only to the first subscriber of the bridge. So this advanced
    subscriber of zenoh-ext queries the bridge's cache for the kept messages.
    """
    zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        receive,
        allowed_origin=zenoh.Locality.REMOTE,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
    )


def command_publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """A publisher of commands, which subscribers of the same session do not receive."""
    return realtime_publisher(session, key, allowed_destination=zenoh.Locality.REMOTE)


def query_kept(session: zenoh.Session, key: str, receive: Callable[[zenoh.Sample], None]) -> None:
    """Query the publishers of a key for their last message, and pass the answers to `receive`.

    A newer message may arrive before the answer. Only publishers with durability TRANSIENT_LOCAL
    answer. They are advanced publishers of zenoh-ext (in the bridge ros2dds 1.10, and in rmw_zenoh
    since 0.2.2), whose cache answers on `<key>/@adv/**`.

    An advanced subscriber would query by itself, but drops a message that it has received before.
    After a loss of the link the driver has forgotten this message, and needs it again.
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
