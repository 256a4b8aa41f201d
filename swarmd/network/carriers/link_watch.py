"""Reports links of names that the roster lacks: their certificates are valid, nothing passes.

Zenoh denies silently, so that a name that was revoked and goes on trying would not be noticed.
"""

from __future__ import annotations

from asyncio import AbstractEventLoop
from collections.abc import Callable

import zenoh

from swarmd.core.clock import boottime
from swarmd.core.threads import hand_over
from swarmd.core.token_bucket import TokenBucket
from swarmd.security.roster import Roster

RATE, BURST = 0.1, 5.0
"""Lines per second, and at once."""


def watch_links(
    session: zenoh.Session,
    roster: Roster,
    loop: AbstractEventLoop,
    on_event: Callable[[str], None],
) -> None:
    """Call `on_event` on the loop with a line for each such link, at a limited rate."""
    rate = TokenBucket(RATE, BURST)

    def on_link(event: zenoh.LinkEvent) -> None:
        name = event.link.auth_identifier
        if event.kind != zenoh.SampleKind.PUT or name is None or roster.role_of(name) is not None:
            return
        if rate.take(1.0, boottime()):
            address = str(event.link.dst).partition("/")[2]
            text = f"{address} has a certificate of {name[:63]!r}, which is not on roster"
            hand_over(loop, on_event, f"{text} {roster.generation}: nothing passes this link")

    session.info.declare_link_events_listener(on_link, history=True)
