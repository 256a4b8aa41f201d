"""The one form in which all benchmarks print: what | goal | p50 | p99 | max | n | note.

A goal has no verdict, since an absolute figure depends on the machine. `benchmarks/budget.py`
judges ratios.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

HEAD = ("what", "goal", "p50", "p99", "max", "n", "note")
SCALES = {"s": ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"))}


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One measured quantity. `unit`: s (shown as s, ms or us), MB, % or x (times).

    `goal`: bounds such as `p50 1.3 ms, p99 4 ms`, `95 MB` (of the median) or `>= 60 x`.
    """

    what: str
    samples: Sequence[float]
    goal: str = ""
    note: str = ""
    unit: str = "s"

    def cells(self) -> tuple[str, ...]:
        """The texts of the columns."""
        if not len(self.samples):
            note = self.note or "nothing measured"
            return (self.what, self.goal, "-", "-", "-", "0", note)
        p50, p99, most = np.percentile(self.samples, [50, 99, 100])
        shown = (show(float(value), self.unit) for value in (p50, p99, most))
        return (self.what, self.goal, *shown, str(len(self.samples)), self.note)


def show(value: float, unit: str) -> str:
    """A value with three digits and the unit that suits its size."""
    scales = SCALES.get(unit, ((1.0, unit),))
    size, name = next((scale for scale in scales if abs(value) >= scale[0]), scales[-1])
    return f"{value / size:.3g} {name}"


def print_table(title: str, rows: Iterable[Row]) -> None:
    """A heading with the load average before and after, and the rows as a Markdown table."""
    before = os.getloadavg()
    cells = [HEAD, *(row.cells() for row in rows)]
    after = os.getloadavg()
    load = " -> ".join(" ".join(f"{average:.1f}" for average in some) for some in (before, after))
    print(f"\n### {title}\n\nLoad average (1, 5, 15 min) {load}\n")
    print(markdown(cells))
    sys.stdout.flush()


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table in columns of even width; the first row is its head."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [_line(row, widths) for row in rows]
    return "\n".join([lines[0], _line(["-" * width for width in widths], widths), *lines[1:]])


def _line(cells: Iterable[str], widths: Sequence[int]) -> str:
    return "| " + " | ".join(c.ljust(w) for c, w in zip(cells, widths, strict=True)) + " |"


def machine() -> str:
    """One line on what this was measured on."""
    versions = ", ".join(f"{name} {version(name)}" for name in _packages())
    return (
        f"{os.cpu_count()} x {_cpu()}, {_memory()}, {platform.system()} {platform.release()},"
        f" Python {platform.python_version()}, {versions}"
    )


def _packages() -> Iterator[str]:
    yield from ("eclipse-zenoh", "numpy", "msgspec", "mujoco-core")


def _cpu() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def _memory() -> str:
    return f"{os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30:.0f} GiB"
