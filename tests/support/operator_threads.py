"""The threads that an operator leaves to end by themselves."""

from __future__ import annotations

import threading

from swarmd.operator.client.hand_over import HAND_OVER
from swarmd.operator.session.looks import LOOKING
from swarmd.operator.session.roster import CLOSING


def is_closing() -> bool:
    """True while a session that was closed, a command or a look of a view has not ended."""
    names = (CLOSING, HAND_OVER, LOOKING)
    return any(thread.name in names for thread in threading.enumerate())
