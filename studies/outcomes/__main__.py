"""Every pattern's outcomes over many seeds: `python -m studies.outcomes [PATTERN ...]`.

Prints a table. Exit code 1 if an outcome is not reached and is not kept as missed, or if as many
runs as are kept, on such a machine, give other values. `--keep` runs the control, too, writes the
values of each run and those of the short form beside the pattern, and the table of the pattern's
page; exit code 0. `--keep-short` makes the values of the short forms alone again, in some minutes
for all patterns. `--still` prints the control alone: the same runs with robots that never move
(studies/outcomes/still.py); exit code 0.
`tests/studies/test_outcomes.py` tests a few seeds.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from studies.night.jobs import stored_runs
from studies.outcomes.catalog import MODULES, short_outcomes
from studies.outcomes.outcome import (
    HEAD,
    Kept,
    Outcome,
    digits_of,
    keep,
    keep_short,
    kept_outcomes,
    other_digits,
    renewal,
)
from studies.outcomes.still import control_of
from swarmd.core.errors import SwarmError, unknown
from swarmd.core.pin import restart_pinned
from swarmd.sim.experiments.run_list import unlisted


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m studies.outcomes", description=__doc__)
    parser.add_argument("patterns", nargs="*", metavar="PATTERN", help="default: all")
    parser.add_argument(
        "--seeds", type=int, help="runs of each setting [20, or as the pattern has]"
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--keep", action="store_true", help="write patterns/PATTERN/outcome.json")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time")
    form.add_argument("--keep-short", action="store_true", help="write the short forms alone")
    form.add_argument("--still", action="store_true", help="the control: robots that never move")
    options = parser.parse_args(arguments)
    for name in options.patterns:
        if name not in MODULES:
            raise SwarmError(unknown("pattern with outcomes", name, MODULES))
    if options.keep_short:
        keep_short_forms(options.patterns or [*MODULES], options.jobs)
        return 0
    print(f"| pattern | {' | '.join(HEAD)} |\n|---{'|---' * len(HEAD)}|")
    kept, problems = kept_outcomes(), 0
    for name in options.patterns or MODULES:
        begin = sum(os.times()[:4])
        begun = time.time()
        seeds = options.seeds or getattr(MODULES[name], "SEEDS", 20)
        if options.still:
            outcomes = control_of(name, options.seeds or 3)
        else:
            outcomes = MODULES[name].outcomes(range(seeds), options.jobs)
        for outcome in outcomes:
            print(f"| {' | '.join((name, *outcome.cells))} |", flush=True)
        if options.keep:
            with unlisted():  # the table has neither of them
                more = short_outcomes(name), control_of(name)
            minutes = (sum(os.times()[:4]) - begin) / 60.0
            stored = stored_runs(begun)
            keep(name, seeds, outcomes, *more, cpu_minutes=minutes, stored_runs=stored)
        elif not options.still:
            known = kept[name].missed if name in kept else []
            problems += sum(not o.is_reached and o.what not in known for o in outcomes)
            if name in kept and kept[name].seeds == seeds:
                problems += report_digits(kept[name], outcomes)
    return 1 if problems else 0


def keep_short_forms(patterns: Sequence[str], jobs: int) -> None:
    """Make the short forms of patterns again, so many at a time, and keep their values."""
    with ProcessPoolExecutor(jobs, mp_context=get_context("fork")) as pool:
        for name, outcomes in zip(patterns, pool.map(short_outcomes, patterns), strict=True):
            keep_short(name, outcomes)
            print(f"{name}: {len(outcomes)} outcomes of the short form are kept", flush=True)


def report_digits(kept: Kept, outcomes: Sequence[Outcome]) -> int:
    """Print which values differ from the kept ones, with the remedy; how many outcomes differ."""
    machine = kept.other_machine()
    if machine is not None:
        print(f"{kept.pattern}: digits not compared: {machine}", file=sys.stderr)
        return 0
    differing = other_digits(digits_of(kept.outcomes), digits_of(outcomes))
    for text in differing:
        print(f"{kept.pattern}: {text}; {renewal(kept.pattern)}", file=sys.stderr)
    return len(differing)


if __name__ == "__main__":
    restart_pinned()  # kept digits are compared on any x86-64
    try:
        raise SystemExit(main())
    except SwarmError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from error
