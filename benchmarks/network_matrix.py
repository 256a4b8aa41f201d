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
from itertools import product
from pathlib import Path

from benchmarks.table import markdown
from tests.support.field import Field, lacks
from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import FAR, HEAD, NEAR, TRUE, Row, cell

ROBOTS = tuple(f"r{number:02d}" for number in range(1, 7))
RTTS = (0, 50, 100, 200, 300, 500, 1000)  # ms
LOSSES = (0, 5, 10, 20)  # %


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rtt", type=float, nargs="+", default=RTTS, metavar="MS")
    parser.add_argument("--loss", type=float, nargs="+", default=LOSSES, metavar="PERCENT")
    parser.add_argument("--repeat", type=int, default=1, help="rounds of the whole matrix")
    parser.add_argument("--json", type=Path, help="write a JSON line for each answer to this file")
    parser.add_argument("--keys", action="store_true", help="a secured swarm")
    options = parser.parse_args(arguments)
    if why := lacks():
        sys.exit(why)

    rows: list[Row] = []
    with contextlib.ExitStack() as left:
        folder = left.enter_context(tempfile.TemporaryDirectory())
        field = left.enter_context(contextlib.closing(Field((*ROBOTS, FAR, NEAR))))
        swarm = left.enter_context(FieldSwarm(Path(folder), field, ROBOTS, is_secured=options.keys))
        swarm.start()
        for _, rtt, loss in product(range(options.repeat), options.rtt, options.loss):
            for row in cell(swarm, rtt / 1000, loss / 100):
                print("; ".join((*row.cells, row.judged.text)), file=sys.stderr)
                rows.append(row)
                if options.json:
                    with options.json.open("a") as lines:
                        lines.write(json.dumps(asdict(row), default=sorted) + "\n")
    print(markdown([HEAD, *(row.cells for row in rows)]))
    wrong = [row for row in rows if row.judged.verdict != TRUE]
    if wrong:
        sys.exit(f"{len(wrong)} of {len(rows)} answers are not true")


if __name__ == "__main__":
    main()
