"""Faults of robots on DDS: `python -m studies.ros [--seed N] [--only WORD]`, ten minutes.

Prints the table of docs/ros_faults.md; standard error gets each line as it is measured. Ends with 2
if there is no bridge.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from studies.ros.chain import Chain
from studies.ros.faults import faults
from studies.ros.study import Row, rows
from studies.ros.table import HEAD, line, summary
from tests.support.ros2_bridge import why_no_bridge


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m studies.ros", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", metavar="WORD", help="faults with this word")
    options = parser.parse_args(arguments)
    if why_no_bridge():
        print(f"error: {why_no_bridge()}", file=sys.stderr)
        return 2
    chosen = [fault for fault in faults() if options.only in fault.name]
    lines = [*HEAD]
    found: list[Row] = []
    with tempfile.TemporaryDirectory() as folder, Chain(Path(folder), options.seed) as chain:
        for row in rows(chain, chosen):
            found.append(row)
            lines.append(line(row, chain.bridge.endpoint))
            print(lines[-1], file=sys.stderr, flush=True)
    print(*lines, "", summary(found, chain.contacts, options.seed), sep="\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
