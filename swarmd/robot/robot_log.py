"""What one robot logs of what its parts notice, within the limits of each kind of event. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.robot.message_limits import EventLimit
from swarmd.robot.standing import HELD_TIME

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmd.robot.state import Lifecycle


class RobotLog:
    """Logs the events of a robot. Times are in s on the robot's clock."""

    def __init__(self, lifecycle: Lifecycle) -> None:
        """`lifecycle`: has the list of events."""
        self._lifecycle = lifecycle
        self._events = EventLimit(lifecycle)

    def protection(self, events: list[str], now: float) -> None:
        """Log all that protection has noticed; empties `events`."""
        while events:
            self._lifecycle.log(events.pop(0), now)

    def steering_failed(self, error: Exception, now: float) -> None:
        """Log that steering raised an error or gave a wrong answer, for which the robot stands."""
        try:
            why = " ".join(str(error).split())
        except Exception:  # of the text itself
            why = "its text cannot be read"
        text = f"steering failed, the robot stands: {type(error).__name__}: {why}"
        self._log("steering", text, now)

    def following(self, text: str, now: float) -> None:
        """Log how the base does not follow its commands, or with an empty text that it does."""
        self._log("following", text or "the base follows its commands again", now)

    def stamps_jumped(self, now: float) -> None:
        """Log that stamps jumped."""
        text = "stamps of odometry or scan jumped: the scan delay is measured anew"
        self._events.log("stamps that jump", text, now)

    def blind_sectors(self, text: str, now: float) -> None:
        """Log the blind sectors of a scan; an empty text is none."""
        self._lifecycle.log(f"scan: {text or 'all sectors return something again'}", now)

    def held(self, now: float) -> None:
        """Log that protection keeps the robot in place."""
        self._log("held", f"protection has held it for {HELD_TIME:.0f} s, with free floor", now)

    def hazards(self, texts: Sequence[str], now: float) -> None:
        """Log all present hazards."""
        self._log("hazards", f"hazards: {', '.join(texts) or 'none any more'}", now)

    def peers(self, kind: str, text: str, robots: Sequence[str], now: float) -> None:
        """Log a finding on peers, which these robots share; `advance` follows."""
        self._events.log(f"peers {kind}", f"peer {', '.join(robots)}: {text}", now)

    def advance(self, now: float) -> None:
        """Log how many events were left out, of each kind of which one more may pass."""
        self._events.advance(now)

    def _log(self, kind: str, text: str, now: float) -> None:
        self._events.log(kind, text, now)
        self._events.advance(now)
