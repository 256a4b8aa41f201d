"""Changes of labels as people write them: `+red -blue`. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from swarmd.core.errors import ConfigError
from swarmd.core.keys import is_id


def read_changes(words: Iterable[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The labels that are added and removed. ConfigError for a wrong word, or without a word."""
    added: list[str] = []
    removed: list[str] = []
    for word in words:
        if word[:1] not in ("+", "-") or not is_id(word[1:]):
            raise ConfigError(f"{word!r}: expected +LABEL or -LABEL, with a-z, 0-9, _ and -")
        (added if word[0] == "+" else removed).append(word[1:])
    for label in added:
        if label in removed:
            raise ConfigError(f"+{label} and -{label} at once; take one of them")
    if not added and not removed:
        raise ConfigError("there is no label; expected +LABEL or -LABEL, such as +red -blue")
    return tuple(added), tuple(removed)


def changed(labels: Iterable[str], added: Iterable[str], removed: Iterable[str]) -> tuple[str, ...]:
    """The labels with changes, in their order."""
    gone = set(removed)
    return tuple(dict.fromkeys([*(label for label in labels if label not in gone), *added]))
