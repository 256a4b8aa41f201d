"""What a daemon measures of itself, beside what its robot knows."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping

from msgspec.structs import replace

from swarmd.core.messages import Health, Sandbox
from swarmd.daemon.tick_timer import TickTimer
from swarmd.daemon.usage import UsageMeter


class HealthMeter:
    """The load of the daemon and its pattern host, the lateness of `timer`, and what was dropped.

    `drops` give what was dropped so far, by kind.
    """

    def __init__(self, timer: TickTimer, drops: Iterable[Callable[[], Mapping[str, int]]]) -> None:
        self._timer = timer
        self._drops = tuple(drops)
        self._own, self._pattern = UsageMeter(), UsageMeter()

    def measure(self, pattern_pid: int | None, now: float) -> None:
        """Measure the load since the last call; call it at 1 Hz."""
        self._own.measure(os.getpid(), now)
        self._pattern.measure(pattern_pid, now)

    def added_to(
        self, health: Health, *, network: str, storage: str, sandbox: Sandbox | None
    ) -> Health:
        """The health of the robot with that of its daemon.

        `network`: the state of the interface. `storage`: why latches would be lost by a restart.
        `sandbox`: of the pattern host.
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
            usage=self._own.usage,
            pattern_usage=self._pattern.usage,
            sandbox=sandbox,
        )
