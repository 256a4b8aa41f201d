"""`get_logger()`: lines for the robot's log, bounded in number."""

from __future__ import annotations

import sys
from collections.abc import Callable
from enum import IntEnum
from typing import Any

from swarmd.core.token_bucket import TokenBucket
from swarmd.ros2_nodes.ros_time import S_TO_NS, Clock

RATE = 5.0
BURST = 50.0
"""Lines a second, and at once, of all nodes of a robot."""
MAX_LINE = 400


class LoggingSeverity(IntEnum):
    """The severities of ROS 2."""

    UNSET = 0
    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


class Logger:
    """A logger of a node; `log(severity, name, text)` takes its lines."""

    def __init__(self, name: str, log: Callable[[str, str, str], None], clock: Clock) -> None:
        self.name = name
        self._log = log
        self._clock = clock
        self._last: dict[str, int] = {}  # ns of the last line, by its text
        self._level = LoggingSeverity.UNSET

    def get_child(self, name: str) -> Logger:
        """A logger below this one."""
        return Logger(f"{self.name}.{name}", self._log, self._clock)

    def set_level(self, level: int) -> None:
        """Drop lines of lower severity."""
        self._level = LoggingSeverity(level)

    def get_effective_level(self) -> LoggingSeverity:
        """The level that was set."""
        return self._level

    def is_enabled_for(self, severity: int) -> bool:
        """Whether a line of this severity is logged."""
        return severity >= self._level

    def debug(self, message: Any, **options: Any) -> None:
        """Log a line for debugging."""
        self._line(LoggingSeverity.DEBUG, message, options)

    def info(self, message: Any, **options: Any) -> None:
        """Log a line."""
        self._line(LoggingSeverity.INFO, message, options)

    def warning(self, message: Any, **options: Any) -> None:
        """Log a warning."""
        self._line(LoggingSeverity.WARN, message, options)

    warn = warning

    def error(self, message: Any, **options: Any) -> None:
        """Log an error."""
        self._line(LoggingSeverity.ERROR, message, options)

    def fatal(self, message: Any, **options: Any) -> None:
        """Log a fatal error."""
        self._line(LoggingSeverity.FATAL, message, options)

    def log(self, message: Any, severity: int, **options: Any) -> None:
        """Log a line of a severity."""
        self._line(LoggingSeverity(severity), message, options)

    def _line(self, severity: LoggingSeverity, message: Any, options: dict[str, Any]) -> None:
        if severity < self._level:
            return
        text = str(message)
        if "throttle_duration_sec" in options or options.get("once"):
            now = self._clock.now().nanoseconds
            pause = options.get("throttle_duration_sec", float("inf"))
            last = self._last.get(text)
            if last is not None and now - last < pause * S_TO_NS:
                return
            if len(self._last) < 1000:
                self._last[text] = now
        self._log(severity.name.lower(), self.name, text)


class LogLines:
    """Writes the lines of a robot's nodes to standard error, at most RATE a second.

    A pattern host sends standard error to the log of its daemon, which `swarmctl logs` shows.
    """

    def __init__(self, robot: str, level: str) -> None:
        self._robot = robot
        self._level = LoggingSeverity[level.upper()]
        self._budget = TokenBucket(RATE, BURST)
        self._left_out = 0

    def write(self, now: float, severity: str, name: str, text: str) -> None:
        """Write a line, or count it; `now` in s."""
        if LoggingSeverity[severity.upper()] < self._level:
            return
        if not self._budget.take(1.0, now):
            self._left_out += 1
            return
        if self._left_out:
            sys.stderr.write(f"{self._robot}: {self._left_out} lines of nodes left out\n")
            self._left_out = 0
        line = " ".join(text.split())[:MAX_LINE]
        sys.stderr.write(f"{self._robot} {name} [{severity}]: {line}\n")
