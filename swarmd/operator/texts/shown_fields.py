"""The lines of a message, by the words of its fields (`shown` of core/messages.py)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from msgspec import Struct
from msgspec.structs import fields

from swarmd.operator.texts.values import NOTHING, quantity, seconds

Texts = Mapping[type, Callable[[Any], str]]
"""By the type of a value, the function that makes its text."""
_EMPTY = (None, "", ())


def shown_lines(message: Struct, group: str, texts: Texts) -> list[tuple[str, str]]:
    """Title and value of each field whose words name `group`, in the order of the fields."""
    return [
        (words.title, _text(getattr(message, field.name), words.extra["unit"], texts))
        for field in fields(type(message))
        for words in getattr(field.type, "__metadata__", ())
        if words.extra is not None
        and words.extra["group"] == group
        and (field.required or getattr(message, field.name) not in _EMPTY)
    ]


def _text(value: Any, unit: str, texts: Texts) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or NOTHING
    if value in _EMPTY:
        return NOTHING
    if type(value) in texts:
        return texts[type(value)](value)
    return seconds(value) if unit == "s" else quantity(value, unit)
