"""What the commands of studies share: their options, and how they print the parts of pages.

A command prints Markdown, its progress goes to the standard error, and the same command resumes.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.experiments.simulate import Progress
from swarmd.sim.experiments.statistics import mean_interval

if TYPE_CHECKING:
    from swarmd.sim.experiments.executor import Executor

FIGURES = Path(__file__).resolve().parents[1] / "docs" / "figures"
SEEDS = 20
"""The seeds of a page."""


def chosen(
    study: str,
    about: str | None,
    words: Sequence[str] | None = None,
    *,
    takes_executor: bool = False,
) -> argparse.Namespace:
    """The options `seeds` and `jobs` of a command, and `on` if it takes an executor."""
    parser = argparse.ArgumentParser(prog=f"python -m studies.{study}", description=about)
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"of each kind of run [{SEEDS}]")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time")
    if takes_executor:
        parser.add_argument("--on", metavar="ADDRESS", help="a Dask scheduler, for the runs")
    return parser.parse_args(words)


@contextmanager
def executor_on(address: str | None) -> Iterator[Executor | None]:
    """The executor of a Dask cluster for `simulate`; None, for processes here, without an address.

    ConfigError if no scheduler answers.
    """
    if address is None:
        yield None
        return
    from swarmd.sim.experiments.executor import dask_cluster

    with dask_cluster(address, warn=lambda line: print(line, file=sys.stderr)) as executor:
        yield executor


def print_parts(parts: Mapping[str, str]) -> None:
    """Print each part of a page below a line with its name."""
    for name, text in parts.items():
        print(f"<!-- results: {name} -->\n\n{text.strip()}\n", flush=True)


def on_progress(what: str) -> Callable[[Progress], None]:
    """For `simulate`: prints a line to the standard error once all runs are done."""

    def show(now: Progress) -> None:
        if now.done == now.total:
            print(f"{what}: {now.total} runs", file=sys.stderr, flush=True)

    return show


def mean_of(values: Array) -> str:
    """The mean of the known values (n,) as a text, with its 95 % interval."""
    known = values[~np.isnan(values)]
    interval = mean_interval(known) if len(known) else None
    mean = f"{known.mean():.2f}" if len(known) else "-"
    return mean if interval is None else f"{mean} ({interval.low:.2f} to {interval.high:.2f})"
