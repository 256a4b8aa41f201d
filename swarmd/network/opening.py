"""Opens a session without holding up the loop; apart from `session`, which swarmctl imports."""

from __future__ import annotations

import asyncio

import zenoh

from swarmd.network.session import SessionSettings, open_session


async def opened_session(settings: SessionSettings) -> zenoh.Session:
    """`open_session` in a thread; closed again if nobody waits for it any more."""
    opening = asyncio.ensure_future(asyncio.to_thread(open_session, settings))
    try:
        return await asyncio.shield(opening)
    except asyncio.CancelledError:
        (await opening).close()
        raise
