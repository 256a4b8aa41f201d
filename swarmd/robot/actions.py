"""What a robot asks its shell to do after one event: values only, to be carried out at once.

What a pattern may say: its declared channels, and not too often.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from swarmd.core.host_messages import CancelTrial, HostCommand, StartTrial
from swarmd.core.messages import Reply, Status
from swarmd.core.values import Twist, Value
from swarmd.protection.decision import Decision
from swarmd.robot.latches import LatchRecord


class Actions(Struct, frozen=True, eq=False):
    """In this order: hand `twist` to the driver, write `latches` down, tell the `host`, publish.

    `messages` are by `<pattern>/<channel>`. `requested_scan_seq` is the scan
    behind `twist` (-1: none). `is_idle` if the robot was never asked or has finished, and its base
    is there. `replies` answer earlier requests too: run is answered when its pattern is ready. `trial` goes
    to whoever carries `host`, before it, and disturbs nothing that runs.
    """

    twist: Twist
    decision: Decision
    requested_scan_seq: int = -1
    is_idle: bool = False
    latches: LatchRecord | None = None
    trial: StartTrial | CancelTrial | None = None
    host: HostCommand | None = None
    messages: Mapping[str, Value] = {}
    status: Status | None = None
    replies: tuple[Reply, ...] = ()


MESSAGES_PER_SECOND = 20.0


class Outbox:
    """Lets at most 20 messages a second pass on each declared channel; counts the rest."""

    def __init__(self) -> None:
        self._tokens: dict[str, float] = {}
        self._at: dict[str, float] = {}
        self.dropped = 0

    def take(
        self, messages: Mapping[str, Value], channels: frozenset[str], now: float
    ) -> dict[str, Value]:
        """Those that may be sent at `now`, by channel."""
        passed = {}
        for channel, value in messages.items():
            if channel in channels and self._spend(channel, now):
                passed[channel] = value
            else:
                self.dropped += 1
        return passed

    def _spend(self, channel: str, now: float) -> bool:
        elapsed = now - self._at.get(channel, -1e9)
        filled = self._tokens.get(channel, 0.0) + elapsed * MESSAGES_PER_SECOND
        tokens = min(filled, MESSAGES_PER_SECOND / 4.0)
        self._at[channel] = now
        is_allowed = tokens >= 1.0
        self._tokens[channel] = tokens - 1.0 if is_allowed else tokens
        return is_allowed
