"""Base classes of the options with entries (`topic_entries.py`): an entry, and all values."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from swarmd.core.errors import ConfigError
from swarmd.core.events import SensorInput


@dataclass(frozen=True, slots=True)
class TopicEntry:
    """An entry of an option: reads values in messages of `message_type` on `topic`."""

    name: str
    option: str
    """The name of the entry in texts, such as `readings.light`."""
    topic: str
    message_type: type
    stale_after: float
    """Seconds; inf: the last message counts until the next one."""

    @property
    def is_never_stale(self) -> bool:
        """True if the last message counts until the next one."""
        return self.stale_after == math.inf


@contextmanager
def faults_of(key: str) -> Iterator[None]:
    """Put `key`, the key of an option that the block reads, before the text of a ConfigError."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(f"{key}: {error}") from None


E = TypeVar("E", bound=TopicEntry)
V = TypeVar("V")


class TopicInputs(ABC, Generic[E, V]):
    """The present values of all entries of one option; times in s of the caller."""

    def __init__(self, entries: Mapping[str, E]) -> None:
        self._entries = entries
        self._values: dict[str, tuple[V, float]] = {}  # value and arrival by entry

    @abstractmethod
    def take(self, name: str, message: Any, now: float, *, is_kept: bool = False) -> str:
        """Take a message for the entry `name`; returns the value of the entry as text.

        `now`: s, the arrival. `is_kept`: the message is from the publisher's cache, so it may be
        older than the value that the entry has, and is used only if the entry has no value.
        """

    @abstractmethod
    def input(self, now: float, *, again: bool = False) -> SensorInput | None:
        """The input with the values of all entries, if it has changed since the last call.

        `again`: return it in any case. None if it has not changed, or without entries.
        """

    def awaited(self, now: float) -> tuple[str, ...]:
        """The topics whose silence holds the robot, and which have been silent for too long."""
        return ()

    def forget(self, topic: str | None = None) -> None:
        """Drop the values that never become stale, of a topic or (None) of all topics."""
        for name, entry in self._entries.items():
            if entry.is_never_stale and topic in (None, entry.topic):
                self._values.pop(name, None)

    def _stale(self, now: float) -> Iterator[E]:
        """The entries that have been silent for longer than `stale_after`, or were never heard."""
        for name, entry in self._entries.items():
            if name not in self._values or now - self._values[name][1] > entry.stale_after:
                yield entry
