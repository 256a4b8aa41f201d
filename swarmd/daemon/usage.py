"""Processor time and memory of processes, from /proc."""

from __future__ import annotations

import os
from pathlib import Path

from swarmd.core.messages import ProcessUsage

_TICK = os.sysconf("SC_CLK_TCK")
_PAGE = os.sysconf("SC_PAGE_SIZE")


class UsageMeter:
    """The usage of one process at a time; call `measure` at 1 Hz, it takes 30 us."""

    def __init__(self) -> None:
        self._pid: int | None = None
        self._time, self._at = 0.0, 0.0
        self.usage: ProcessUsage | None = None

    def measure(self, pid: int | None, now: float) -> None:
        """Set `usage` to that since the last call; None without an earlier call or a process."""
        found = None if pid is None else _read(pid)
        if found is None:
            self._pid, self.usage = None, None
            return
        time, memory = found
        if pid == self._pid and now > self._at:
            share = max(time - self._time, 0.0) / (now - self._at)
            self.usage = ProcessUsage(cpu=share, memory=memory)
        else:
            self.usage = None
        self._pid, self._time, self._at = pid, time, now


def _read(pid: int) -> tuple[float, int] | None:
    """Processor time in s and resident memory in bytes (proc_pid_stat(5)); None: no such process.

    The name of the process may contain spaces and brackets; its fields follow the last one.
    """
    try:
        stat = Path(f"/proc/{pid}/stat").read_bytes()
        fields = stat[stat.rindex(b")") + 2 :].split()
        return (int(fields[11]) + int(fields[12])) / _TICK, int(fields[21]) * _PAGE
    except (OSError, ValueError, IndexError):
        return None
