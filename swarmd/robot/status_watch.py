"""When a robot publishes its status: after a change that peers act on, else once a period. Pure."""

from __future__ import annotations

from swarmd.core.messages import Reason
from swarmd.robot.protection.decision import Decision
from swarmd.robot.sensors import Sensors
from swarmd.robot.state import Lifecycle
from swarmd.robot.status import status_reason


class StatusWatch:
    """Remembers the values that were published last."""

    def __init__(self, lifecycle: Lifecycle, sensors: Sensors) -> None:
        self._lifecycle = lifecycle
        self._sensors = sensors
        self._published: tuple[object, ...] = ()

    def take_due(self, decision: Decision, is_recent: bool) -> bool:
        """True if the caller must publish the status, which then counts as published.

        `decision`: the last one of protection. `is_recent`: the period since the last status is not
        over; a status is due then if a value that peers act on has changed.
        """
        values = self._values(decision)
        if values == self._published and is_recent:
            return False
        self._published = values
        return True

    def _values(self, decision: Decision) -> tuple[object, ...]:
        """The values whose change must be published before the period is over."""
        lifecycle = self._lifecycle
        machine = lifecycle.state_machine
        reason = status_reason(lifecycle, decision)
        if reason in (Reason.NO_REQUESTED_COMMAND, Reason.PROTECTION):
            reason = None  # may change with every scan: not worth a status before its time
        running = lifecycle.pattern_run.running
        loading = lifecycle.pattern_run.loading
        return (
            machine.state,
            reason,
            machine.detail,
            lifecycle.revision,
            None if running is None else running.generation,
            None if running is None else running.values,
            None if loading is None else loading.generation,
            tuple(lifecycle.latches.held),
            self._sensors.is_driver_up,
            self._sensors.hazards.present,
            None if lifecycle.pattern_run.hand is None else lifecycle.pattern_run.hand.id,
        )
