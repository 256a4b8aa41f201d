"""What patterns print, for the daemon's log: whole lines, limited in rate."""

from __future__ import annotations

import logging
import os
import threading
import time

from swarmd.core.token_bucket import TokenBucket

log = logging.getLogger("swarmd.pattern")

RATE, BURST = 20.0, 100.0  # lines a second and at once
MAX_LINE = 500  # bytes
READ = 65536
PAUSE = 0.02
"""s between two reads: a pattern that prints more than 3 MB/s waits, and not the daemon."""


class PrintedLines:
    """Splits bytes into lines and limits their rate. Pure; times in s, handed in."""

    def __init__(self) -> None:
        self._budget = TokenBucket(RATE, BURST)
        self._rest = b""
        self._left_out = 0

    def take(self, data: bytes, now: float) -> list[str]:
        """The lines that end in `data` and may be logged now; those left out are told before."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[:MAX_LINE]
        found: list[str] = []
        for number, line in enumerate(lines):
            if not self._budget.take(1.0, now):
                self._left_out += len(lines) - number
                break
            if self._left_out:
                found.append(self._told())
            found.append(line[:MAX_LINE].decode(errors="replace").rstrip())
        return [one for one in found if one]

    def _told(self) -> str:
        count, self._left_out = self._left_out, 0
        return f"[{count} lines left out]"


class PrintPipe:
    """A pipe that hosts print into; a thread logs what comes out until `close`."""

    def __init__(self) -> None:
        self._read, self.write = os.pipe2(os.O_CLOEXEC)
        threading.Thread(target=self._run, name="swarmd-printed", daemon=True).start()

    def close(self) -> None:
        """Write no more. The thread ends when the hosts have ended, too."""
        if self.write >= 0:
            os.close(self.write)
            self.write = -1

    def _run(self) -> None:
        lines = PrintedLines()
        while data := os.read(self._read, READ):
            for line in lines.take(data, time.monotonic()):
                log.info("%s", line)
            if len(data) > READ // 8:
                time.sleep(PAUSE)
        os.close(self._read)
