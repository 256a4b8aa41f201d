"""Values in short."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # `swarmctl --help` needs no message
    from swarmd.core.messages import Sandbox

NOTHING = "-"


def printable(text: str) -> str:
    """The text in one line, control characters as `?`: robots send it to this terminal."""
    return "".join(char if char.isprintable() else "?" for char in text)


def counted(count: int, noun: str) -> str:
    """A number of things: `1 robot`, `2 robots`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def seconds(value: float) -> str:
    """A time span in short: `3 ms`, `1.2 s`, `5 min`, `3 h`."""
    if value < 0.9995:
        return f"{value * 1000:.0f} ms"
    if value < 99.95:
        return f"{value:.1f} s"
    return f"{value / 60:.0f} min" if value < 5400 else f"{value / 3600:.0f} h"


def centimetres(length: float) -> str:
    """A length of m in whole centimetres that suffice: `0.40 m` for 0.395."""
    return f"{math.ceil(100.0 * length - 1e-6) / 100.0:.2f} m"


def sandbox_text(sandbox: Sandbox) -> str:
    """The accesses that the sandbox denies to plugin code, such as `files, network denied`.

    If the sandbox fails to deny some accesses, the text ends with `; not denied:` and these.
    """
    denied = f"{', '.join(sandbox.denied)} denied" if sandbox.denied else "not confined"
    return f"{denied}; not denied: {sandbox.missing}" if sandbox.missing else denied


def megabytes(value: int, digits: int = 0) -> str:
    """An amount of memory or the size of a file: `68 MB`."""
    return f"{value / 1e6:.{digits}f} MB"


def number(value: object) -> str:
    """A value in short: floats with six digits, and never `-0`."""
    return f"{value + 0.0:.6g}" if isinstance(value, float) else str(value)


def short_number(value: object) -> str:
    """As `number`, but floats below 1000 with four digits, for display."""
    if isinstance(value, float) and abs(value) < 1000.0:
        return f"{value + 0.0:.4g}"
    return number(value)


def quantity(value: object, unit: str | None) -> str:
    """A value in short, a number with its unit: `0.35 m`."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return f"{short_number(value)} {unit}" if unit and is_number else short_number(value)


def clock_cells(row: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """Offset, drift, error and the robots in between of a row of `daemon/recording/merge.py`, as
    texts."""
    if not row["is_aligned"]:
        return "unaligned", NOTHING, NOTHING, NOTHING
    return (
        f"{row['offset']:.6f} s",
        f"{row['drift_ppm']:+.1f} ppm",
        f"{1000.0 * row['error']:.3f} ms",
        ", ".join(row["via"]) or NOTHING,
    )
