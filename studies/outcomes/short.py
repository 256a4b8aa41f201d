"""The short forms of patterns from a pinned process: `python -m studies.outcomes.short`.

Reads the name of a pattern from each line of the standard input, and answers with a line of JSON:
`software` and `outcomes`, whose values that are not finite are NaN and Infinity.
"""

from __future__ import annotations

import json
import sys

import msgspec

from studies.outcomes.catalog import short_outcomes
from studies.outcomes.outcome import software
from swarmd.core.pin import restart_pinned


def main() -> None:
    """Answer until the standard input ends."""
    answers = sys.stdout
    sys.stdout = sys.stderr  # what a study prints is no answer
    for line in sys.stdin:
        answer = {
            "software": software(),
            "outcomes": msgspec.to_builtins(short_outcomes(line.strip())),
        }
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    restart_pinned()
    main()
