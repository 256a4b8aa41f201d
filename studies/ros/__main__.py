"""Faults of robots on DDS: `python -m studies.ros [OUT] [--seed N] [--only WORD]`, ten minutes.

Writes the table to OUT/faults.md (build/ros by default) and, if all faults were injected, into
`docs/ros_faults.md`. Ends with 1 if a base got a command that it must not get.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from studies.ros.chain import Chain
from studies.ros.faults import Fault, faults
from studies.ros.study import Row, rows
from studies.ros.table import HEAD, insert, line, summary
from tests.support.ros2_bridge import why_no_bridge

PAGE = Path(__file__).resolve().parents[2] / "docs/ros_faults.md"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m studies.ros", description=__doc__)
    parser.add_argument("out", nargs="?", type=Path, default=Path("build/ros"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", metavar="WORD", help="faults with this word")
    parser.add_argument("--jobs", type=int, default=1, help="chains at a time, for a fast machine")
    options = parser.parse_args(arguments)
    if why_no_bridge():
        print(f"error: {why_no_bridge()}", file=sys.stderr)
        return 2
    chosen = [fault for fault in faults() if options.only in fault.name]
    print(*HEAD, sep="\n", flush=True)
    parts = [chosen[start :: options.jobs] for start in range(options.jobs)]
    with ThreadPoolExecutor(options.jobs) as pool:
        played = list(pool.map(partial(_play, seed=options.seed), parts))
    rows_by_name = {fault: row for rows_of, _, _ in played for fault, row in rows_of.items()}
    texts = {fault: text for _, texts_of, _ in played for fault, text in texts_of.items()}
    touched = [
        sum(pair) for pair in zip(*(json.loads(ended) for _, _, ended in played), strict=True)
    ]
    every = [fault.name for fault in chosen]
    text = summary([rows_by_name[name] for name in every], json.dumps(touched), options.seed)
    lines = [*HEAD, *(texts[name] for name in every), "", text]
    print(*lines[-2:], sep="\n")
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "faults.md").write_text("\n".join(lines) + "\n")
    if not options.only:
        insert(PAGE, lines)
    return 1 if any(row.is_late for row in rows_by_name.values()) else 0


def _play(part: Sequence[Fault], seed: int) -> tuple[dict[str, Row], dict[str, str], str]:
    """The rows of some faults and their lines by name, and the contacts, of a chain of its own."""
    rows_by_name, texts = {}, {}
    with tempfile.TemporaryDirectory() as folder, Chain(Path(folder), seed) as chain:
        for row in rows(chain, part):
            rows_by_name[row.fault.name] = row
            texts[row.fault.name] = line(row, chain.bridge.endpoint)
            print(texts[row.fault.name], flush=True)
    return rows_by_name, texts, chain.contacts


if __name__ == "__main__":
    raise SystemExit(main())
