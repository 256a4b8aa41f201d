"""Which robots a look of an operator dials."""

from __future__ import annotations

from enum import StrEnum


class Dials(StrEnum):
    """Which robots a look dials."""

    ALL = "all"  # a request follows, or what robots publish is watched
    UNTOLD = "untold"  # those whose status comes by no datagram
    NONE = "none"  # for a look that needs no status
