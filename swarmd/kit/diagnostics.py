"""Faults of a file, gathered rather than raised, so that all of them are told at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

from swarmd.core.errors import unknown

Keys: TypeAlias = tuple[str | int, ...]


class Faults:
    """What is wrong, with the keys of where."""

    def __init__(self) -> None:
        self.found: list[tuple[Keys, str]] = []

    def add(self, keys: Keys, text: str) -> None:
        """Note a fault at a key."""
        self.found.append((keys, text))

    def only(self, data: Mapping[str, Any], known: Iterable[str], keys: Keys) -> bool:
        """Whether there are no other keys than these; each other one is noted."""
        names = tuple(known)
        others = [key for key in data if key not in names]
        for key in others:
            self.add((*keys, key), unknown("key", key, names))
        return not others

    def number(
        self,
        data: Mapping[str, Any],
        key: str,
        keys: Keys,
        *,
        low: float,
        high: float,
        unit: str = "",
    ) -> float | None:
        """The number under a key, above `low` and up to `high`; None if it is none."""
        wanted = f"wanted a number above {low:g} and up to {high:g} {unit}".rstrip()
        if key not in data:
            self.add((*keys, key), f"is missing; {wanted}")
            return None
        value = data[key]
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not low < value <= high:
            self.add((*keys, key), f"is {value!r}; {wanted}")
            return None
        return float(value)

    def text(self, data: Mapping[str, Any], key: str, keys: Keys, wanted: str) -> str | None:
        """The text under a key; None if it is none."""
        if key not in data:
            self.add((*keys, key), f"is missing; wanted {wanted}")
            return None
        value = data[key]
        if not isinstance(value, str) or not value:
            self.add((*keys, key), f"is {value!r}; wanted {wanted}")
            return None
        return value

    def part(self, keys: Keys, name: str, parts: Iterable[str]) -> None:
        """Note that there is no such part."""
        self.add(keys, unknown("part", name, parts))
