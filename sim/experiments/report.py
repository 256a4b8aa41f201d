"""Statistics as tables of text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from swarmd.sim.experiments.statistics import Interval, Summary
from swarmd.sim.metrics.metric import Metric

HEADER = ("METRIC", "UNIT", "MEAN", "95 %", "MEDIAN", "95 %", "MIN", "MAX", "RUNS")
NOTHING = "-"


def summary_rows(summaries: Iterable[tuple[Metric, Summary]]) -> list[tuple[str, ...]]:
    """A row of cells for each metric; a metric that is 0 or 1 has the interval of its share.

    A time to an event that never happened in some runs has their number instead of a mean.
    """
    return [
        (
            metric.name,
            metric.unit or NOTHING,
            f"{one.never} of {one.n + one.never} never" if one.never else number(one.mean),
            interval(one.mean_interval if one.share is None else one.share_interval),
            number(one.median) if one.share is None else NOTHING,
            interval(one.median_interval if one.share is None else None),
            number(one.min),
            number(one.max),
            str(one.n + (one.never or 0)),
        )
        for metric, one in summaries
    ]


def aligned(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of aligned columns."""
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in (header, *rows)
    ]


def number(value: float | None) -> str:
    """The value with four significant digits."""
    return NOTHING if value is None else f"{value:.4g}"


def interval(found: Interval | None) -> str:
    """Both ends, with four significant digits each."""
    return NOTHING if found is None else f"{found.low:.4g} to {found.high:.4g}"
