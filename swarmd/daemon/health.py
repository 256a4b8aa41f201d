"""The health of a daemon: lateness of its loop, dropped inputs, and load of its processes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from msgspec.structs import replace

from swarmd.core.messages import Health, ProcessUsage, Sandbox
from swarmd.daemon.tick_timer import TickTimer

_TICK = os.sysconf("SC_CLK_TCK")
_PAGE = os.sysconf("SC_PAGE_SIZE")


class UsageMeter:
    """Measures processor and memory usage of a process; `measure` takes 30 us, called at 1 Hz."""

    def __init__(self) -> None:
        self._pid: int | None = None
        self._time = 0.0
        self._at = 0.0
        self.usage: ProcessUsage | None = None

    def measure(self, pid: int | None, now: float) -> None:
        """Set `usage` to the usage since the last call; None at first, or without a process."""
        found = None if pid is None else _read(pid)
        if found is None:
            self._pid = None
            self.usage = None
            return
        time, memory = found
        if pid == self._pid and now > self._at:
            share = max(time - self._time, 0.0) / (now - self._at)
            self.usage = ProcessUsage(cpu=share, memory=memory)
        else:
            self.usage = None
        self._pid = pid
        self._time = time
        self._at = now


def _read(pid: int) -> tuple[float, int] | None:
    """Processor time in s and resident memory in bytes (proc_pid_stat(5)); None: no such process.

    The name of the process stands in brackets, and may itself contain spaces and brackets: the
    other fields follow the last bracket.
    """
    try:
        stat = Path(f"/proc/{pid}/stat").read_bytes()
        fields = stat[stat.rindex(b")") + 2 :].split()
        return (int(fields[11]) + int(fields[12])) / _TICK, int(fields[21]) * _PAGE
    except (OSError, ValueError, IndexError):
        return None


class HealthMeter:
    """Load of the daemon and its pattern host, lateness of `timer`, and counts of drops.

    `drops`: functions that return the counts of drops so far, by kind.
    """

    def __init__(self, timer: TickTimer, drops: Iterable[Callable[[], Mapping[str, int]]]) -> None:
        self._timer = timer
        self._drops = tuple(drops)
        self._own = UsageMeter()
        self._pattern = UsageMeter()

    def measure(self, pattern_pid: int | None, now: float) -> None:
        """Measure the load since the last call; call it at 1 Hz."""
        self._own.measure(os.getpid(), now)
        self._pattern.measure(pattern_pid, now)

    def added_to(
        self, health: Health, *, network: str, storage: str, black_box: str, sandbox: Sandbox | None
    ) -> Health:
        """The robot's `health` with the values that the daemon measures.

        `network`: the state of the interface in words. `storage`: why a restart would lose latches;
        empty if a restart would keep them. `black_box`: what it keeps, in words. `sandbox`: the
        sandbox of the pattern host.
        """
        dropped = dict(health.dropped)
        for drops in self._drops:
            dropped |= drops()
        return replace(
            health,
            loop_p99=self._timer.p99,
            loop_stalls=self._timer.stalls,
            dropped=dropped,
            network=network,
            storage=storage[:1000],
            black_box=black_box[:1000],
            usage=self._own.usage,
            pattern_usage=self._pattern.usage,
            sandbox=sandbox,
        )
