"""Keeps the records of `logging` for operators, beside the log of the daemon itself."""

from __future__ import annotations

import logging

from swarmd.core.clock import boottime
from swarmd.core.log_ring import LogRing

PATTERN = "pattern"
"""The source of what a pattern prints."""


class LogCapture(logging.Handler):
    """Puts each record into a ring, from any thread; on the root logger until `close`."""

    def __init__(self, ring: LogRing) -> None:
        super().__init__()
        self._ring = ring
        logging.getLogger().addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record; its source is the module without the name of the package."""
        source = record.name.removeprefix("swarmd.")
        text = record.getMessage()
        if record.exc_info and record.exc_info[1] is not None:
            error = record.exc_info[1]
            text = f"{text}: {type(error).__name__}: {error}"
        self._ring.add(boottime(), record.levelno, source, text)

    def close(self) -> None:
        """Keep no more."""
        logging.getLogger().removeHandler(self)
        super().close()
