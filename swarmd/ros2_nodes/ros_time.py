"""`rclpy.time`, `rclpy.duration` and `rclpy.clock` on the time that the robot hands in."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Any, ClassVar, NoReturn

S_TO_NS = 1_000_000_000


class ClockType(IntEnum):
    """The clocks of ROS 2, which are one here."""

    ROS_TIME = 1
    SYSTEM_TIME = 2
    STEADY_TIME = 3


class Duration:
    """A length of time, as `rclpy.duration.Duration`."""

    _kind: ClassVar[Any]  # gives the class of a message by its name

    def __init__(self, *, seconds: float = 0, nanoseconds: float = 0) -> None:
        self.nanoseconds = int(seconds * S_TO_NS) + int(nanoseconds)

    def to_msg(self) -> Any:
        """Its message, `builtin_interfaces/Duration`."""
        return _stamp(self._kind("builtin_interfaces/msg/Duration"), self.nanoseconds)

    @classmethod
    def from_msg(cls, msg: Any) -> Duration:
        """The duration of a message."""
        return cls(seconds=msg.sec, nanoseconds=msg.nanosec)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Duration) and self.nanoseconds == other.nanoseconds

    def __hash__(self) -> int:
        return hash(self.nanoseconds)

    def __lt__(self, other: Duration) -> bool:
        return self.nanoseconds < other.nanoseconds

    def __le__(self, other: Duration) -> bool:
        return self.nanoseconds <= other.nanoseconds

    def __gt__(self, other: Duration) -> bool:
        return self.nanoseconds > other.nanoseconds

    def __ge__(self, other: Duration) -> bool:
        return self.nanoseconds >= other.nanoseconds

    def __repr__(self) -> str:
        return f"Duration(nanoseconds={self.nanoseconds})"


class Time:
    """A time, as `rclpy.time.Time`; 0 is when the nodes began."""

    _kind: ClassVar[Any]  # gives the class of a message by its name
    _duration: ClassVar[type[Duration]] = Duration

    def __init__(
        self,
        *,
        seconds: float = 0,
        nanoseconds: float = 0,
        clock_type: ClockType = ClockType.ROS_TIME,
    ) -> None:
        self.nanoseconds = int(seconds * S_TO_NS) + int(nanoseconds)
        self.clock_type = clock_type

    def seconds_nanoseconds(self) -> tuple[int, int]:
        """(whole seconds, nanoseconds beyond them)."""
        return self.nanoseconds // S_TO_NS, self.nanoseconds % S_TO_NS

    def to_msg(self) -> Any:
        """Its message, `builtin_interfaces/Time`."""
        return _stamp(self._kind("builtin_interfaces/msg/Time"), self.nanoseconds)

    @classmethod
    def from_msg(cls, msg: Any, clock_type: ClockType = ClockType.ROS_TIME) -> Time:
        """The time of a message."""
        return cls(seconds=msg.sec, nanoseconds=msg.nanosec, clock_type=clock_type)

    def __add__(self, other: Duration) -> Time:
        return type(self)(nanoseconds=self.nanoseconds + other.nanoseconds)

    def __sub__(self, other: Time | Duration) -> Time | Duration:
        difference = self.nanoseconds - other.nanoseconds
        if isinstance(other, Time):
            return self._duration(nanoseconds=difference)
        return type(self)(nanoseconds=difference)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Time) and self.nanoseconds == other.nanoseconds

    def __hash__(self) -> int:
        return hash(self.nanoseconds)

    def __lt__(self, other: Time) -> bool:
        return self.nanoseconds < other.nanoseconds

    def __le__(self, other: Time) -> bool:
        return self.nanoseconds <= other.nanoseconds

    def __gt__(self, other: Time) -> bool:
        return self.nanoseconds > other.nanoseconds

    def __ge__(self, other: Time) -> bool:
        return self.nanoseconds >= other.nanoseconds

    def __repr__(self) -> str:
        return f"Time(nanoseconds={self.nanoseconds}, clock_type={self.clock_type.name})"


def time_classes(kind: Callable[[str], type]) -> tuple[type[Time], type[Duration]]:
    """Time and Duration of a robot, whose messages are of its classes: `kind` gives these."""
    stamped = {"_kind": staticmethod(kind)}
    duration = type("Duration", (Duration,), stamped)
    return type("Time", (Time,), {**stamped, "_duration": duration}), duration


def _stamp(kind: type, nanoseconds: int) -> Any:
    message: Any = kind()
    message.sec = nanoseconds // S_TO_NS
    message.nanosec = nanoseconds % S_TO_NS
    return message


class Clock:
    """A clock that shows the robot's time; `seconds` gives it."""

    def __init__(
        self, seconds: Callable[[], float], time: type[Time], refuse: Callable[[str], NoReturn]
    ) -> None:
        self._seconds = seconds
        self._time = time
        self._refuse = refuse
        self.clock_type = ClockType.ROS_TIME

    def now(self) -> Time:
        """The time of the present callback."""
        return self._time(nanoseconds=round(self._seconds() * S_TO_NS))

    def sleep_for(self, *_: Any, **__: Any) -> NoReturn:
        """Refused: a callback never waits."""
        self._refuse("Clock.sleep_for: a callback never waits; use a timer (`create_timer`)")

    def sleep_until(self, *_: Any, **__: Any) -> NoReturn:
        """Refused: a callback never waits."""
        self._refuse("Clock.sleep_until: a callback never waits; use a timer (`create_timer`)")
