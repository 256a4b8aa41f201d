"""`make network`: are the answers of swarmctl true at every delay and loss? Six robots; needs root.

Prints a Markdown table; exit code 1 if any answer is not true. See tests/support/network_matrix.py.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.table import markdown
from tests.support.field import lacks
from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import HEAD, ROBOTS, TRUE, Row, field, matrix

RTTS = (0, 50, 100, 200, 300, 500, 1000)  # ms
LOSSES = (0, 5, 10, 20)  # %


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rtt", type=float, nargs="+", default=RTTS, metavar="MS")
    parser.add_argument("--loss", type=float, nargs="+", default=LOSSES, metavar="PERCENT")
    parser.add_argument("--repeat", type=int, default=1, help="rounds of the whole matrix")
    parser.add_argument("--json", type=Path, help="write a JSON line for each answer to this file")
    options = parser.parse_args(arguments)
    if why := lacks():
        sys.exit(why)

    def report(row: Row) -> None:
        print("; ".join((*row.cells, row.text.replace("\n", " / "))), file=sys.stderr)
        if options.json:
            with options.json.open("a") as lines:
                lines.write(json.dumps(asdict(row)) + "\n")

    rtts = tuple(one / 1000 for one in options.rtt)
    losses = tuple(one / 100 for one in options.loss)
    found = []
    with contextlib.ExitStack() as left:
        folder = left.enter_context(tempfile.TemporaryDirectory())
        made = left.enter_context(contextlib.closing(field()))
        swarm = left.enter_context(FieldSwarm(Path(folder), made, ROBOTS))
        swarm.start()
        for _ in range(options.repeat):
            found += matrix(swarm, rtts, losses, report)
    print(markdown([HEAD, *(row.cells for row in found)]))
    wrong = [row for row in found if row.verdict != TRUE]
    if wrong:
        sys.exit(f"{len(wrong)} of {len(found)} answers are not true")


if __name__ == "__main__":
    main()
