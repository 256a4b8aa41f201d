"""What the searches have seen, for the table of docs/evidence/motion.md: `figures.json`.

`python -m tests.sequences robot --figures` writes the file again; `make reference` then writes the
table.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
from msgspec import Struct

from tests.sequences.search import Tally

FILE = Path(__file__).with_name("figures.json")


class Searched(Struct, frozen=True):
    """One search: its alphabet and depth, and by rule how many sequences put it to the test."""

    actions: int
    depth: int
    sequences: int
    judged: dict[str, int]
    violations: int = 0


Figures = dict[str, dict[str, Searched]]
"""By subject and search."""


def read_figures() -> Figures:
    """The kept figures."""
    return msgspec.json.decode(FILE.read_bytes(), type=Figures) if FILE.exists() else {}


def write_figures(subject: str, name: str, actions: int, depth: int, total: Tally) -> None:
    """Keep the figures of a search."""
    figures = read_figures()
    judged = dict(sorted(total.judged.items()))
    found = Searched(actions, depth, total.sequences, judged, len(total.violations))
    figures.setdefault(subject, {})[name] = found
    content = msgspec.json.encode(dict(sorted(figures.items())))
    FILE.write_bytes(msgspec.json.format(content, indent=1) + b"\n")
