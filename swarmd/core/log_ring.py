"""Keeps the last lines of a daemon's log and of its pattern's output, for `swarmctl logs`. Pure.

The count, the length and the rate of lines are bounded for each source: a flood of one source costs
little memory, and leaves room for lines of all other sources.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable

from swarmd.core.token_bucket import TokenBucket
from swarmd.core.verbs import LOG_PAGE, MAX_LOG_LINE, LogRecord, LogsQuery

CAPACITY = 1000
# lines per second, and in one burst, of each source
RATE = 50.0
BURST = 200.0
MAX_SOURCES = 64


class LogRing:
    """The last CAPACITY records; any thread may add one. Times in s, handed in."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._records: deque[LogRecord] = deque(maxlen=CAPACITY)
        self._budgets: dict[str, TokenBucket] = {}
        self.last = 0
        """The number of the latest record."""
        self.left_out = 0
        """Lines that came too fast to be kept."""

    def add(self, now: float, level: int, source: str, text: str) -> None:
        """Keep a record, as one line of at most MAX_LOG_LINE, if the rate of its source permits."""
        with self._lock:
            if source not in self._budgets and len(self._budgets) >= MAX_SOURCES:
                self._budgets.clear()
            budget = self._budgets.setdefault(source, TokenBucket(RATE, BURST))
            if not budget.take(1.0, now):
                self.left_out += 1
                return
            line = "".join(char if char.isprintable() else " " for char in text[:MAX_LOG_LINE])
            self.last += 1
            self._records.append(LogRecord(self.last, now, level, source[:64], line))

    def since(self, seq: int) -> list[LogRecord]:
        """The records with a greater number than `seq`; of more than LOG_PAGE the latest."""
        with self._lock:
            records = [record for record in self._records if record.seq > seq]
        return records[-LOG_PAGE:]

    def matching(self, query: LogsQuery) -> list[LogRecord]:
        """The last records that a query asks for."""
        with self._lock:
            records = list(self._records)
        return list(matching(records, query.level, query.grep))[-query.count :]


def matching(records: Iterable[LogRecord], level: int, grep: str) -> Iterable[LogRecord]:
    """The records of at least `level` that contain `grep`, ignoring case."""
    wanted = grep.casefold()
    return (
        record for record in records if record.level >= level and wanted in record.text.casefold()
    )
