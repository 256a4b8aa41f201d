"""Every pattern's outcomes over many seeds: `python -m studies.outcomes [PATTERN ...]`.

Prints a table. Exit code 1 if an outcome is not reached. `--keep` writes the values of each run
beside the pattern, and the table of the pattern's page.
`tests/studies/test_outcomes.py` tests a few seeds.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from studies.outcomes.catalog import MODULES
from studies.outcomes.outcome import HEAD, keep
from swarmd.core.errors import SwarmError, unknown


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m studies.outcomes", description=__doc__)
    parser.add_argument("patterns", nargs="*", metavar="PATTERN", help="default: all")
    parser.add_argument("--seeds", type=int, default=20, help="runs of each setting [20]")
    parser.add_argument("--keep", action="store_true", help="write patterns/PATTERN/outcome.json")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time")
    options = parser.parse_args(arguments)
    for name in options.patterns:
        if name not in MODULES:
            raise SwarmError(unknown("pattern with outcomes", name, MODULES))
    print(f"| pattern | {' | '.join(HEAD)} |\n|---{'|---' * len(HEAD)}|")
    missed = 0
    for name in options.patterns or MODULES:
        outcomes = MODULES[name].outcomes(range(options.seeds), options.jobs)
        for outcome in outcomes:
            print(f"| {outcome.pattern} {outcome.row}", flush=True)
            missed += not outcome.is_reached
        if options.keep:
            keep(name, options.seeds, outcomes)
    return 1 if missed else 0


if __name__ == "__main__":
    try:
        raise SystemExit(main())
    except SwarmError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from error
