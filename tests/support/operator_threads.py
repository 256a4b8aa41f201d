"""The threads that an operator leaves to end by themselves."""

from __future__ import annotations

import threading

from swarmd.client.swarm_watch import LOOKING
from swarmd.network.spread.roster_follower import CLOSING
from swarmd.view.commander import COMMANDING


def is_closing() -> bool:
    """True while a session that was closed, a command or a look of a view has not ended."""
    names = (CLOSING, COMMANDING, LOOKING)
    return any(thread.name in names for thread in threading.enumerate())
