"""Every pattern's outcomes over many seeds: `python -m studies.outcomes [PATTERN ...]`.

Prints a table. Exit code 1 if an outcome is not reached and is not kept as missed, or if as many
runs as are kept, on such a machine, give other values. `--keep` writes the values of each run and
those of the short form beside the pattern, and the table of the pattern's page. `--still` prints
the rows that robots that never move reach, too (studies/outcomes/still.py); exit code 0.
`tests/studies/test_outcomes.py` tests a few seeds.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from studies.outcomes import still
from studies.outcomes.catalog import MODULES, short_outcomes
from studies.outcomes.outcome import (
    HEAD,
    Kept,
    Outcome,
    digits_of,
    keep,
    kept_outcomes,
    other_digits,
    renewal,
)
from swarmd.core.errors import SwarmError, unknown


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m studies.outcomes", description=__doc__)
    parser.add_argument("patterns", nargs="*", metavar="PATTERN", help="default: all")
    parser.add_argument("--seeds", type=int, default=20, help="runs of each setting [20]")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--keep", action="store_true", help="write patterns/PATTERN/outcome.json")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time")
    form.add_argument("--still", action="store_true", help="the control: robots that never move")
    options = parser.parse_args(arguments)
    for name in options.patterns:
        if name not in MODULES:
            raise SwarmError(unknown("pattern with outcomes", name, MODULES))
    if options.still:
        print(still.report(options.patterns or list(MODULES), options.seeds, options.jobs))
        return 0
    print(f"| pattern | {' | '.join(HEAD)} |\n|---{'|---' * len(HEAD)}|")
    kept, problems = kept_outcomes(), 0
    for name in options.patterns or MODULES:
        outcomes = MODULES[name].outcomes(range(options.seeds), options.jobs)
        for outcome in outcomes:
            print(f"| {outcome.pattern} {outcome.row}", flush=True)
        known = kept[name].missed if name in kept else []
        problems += sum(not o.is_reached and o.what not in known for o in outcomes)
        if options.keep:
            keep(name, options.seeds, outcomes, short_outcomes(name))
        elif name in kept and kept[name].seeds == options.seeds:
            problems += report_digits(kept[name], outcomes)
    return 1 if problems else 0


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
    try:
        raise SystemExit(main())
    except SwarmError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from error
