"""Faults of robots on DDS: `python -m studies.ros [--seed N] [--only WORD]`, ten minutes.

Prints the table of docs/ros_faults.md; standard error gets each line as it is measured. The same
command resumes. Ends with 2 if there is no bridge.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

from msgspec import Struct

from studies import keeper
from studies.keeper import Traced
from studies.ros.chain import Chain
from studies.ros.faults import Fault, faults
from studies.ros.study import Row, play
from studies.ros.table import HEAD, line, summary
from tests.support.ros2_bridge import why_no_bridge

FILE = Path("build/ros/rows.jsonl")


class Task(Struct, frozen=True):
    """A row to measure."""

    fault: str
    seed: int


class Found(Struct, frozen=True):
    """A row without its fault, and what else its line needs.

    `endpoint`: the bridge's, which differs in each start. `contacts`: how often robots touched each
    other, and walls, while the row was measured.
    """

    values: dict[str, Any]
    endpoint: str
    contacts: tuple[int, int]


Record: TypeAlias = keeper.Record[Task, Found]
"""A measured row."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m studies.ros", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", metavar="WORD", help="faults with this word")
    options = parser.parse_args(arguments)
    if why_no_bridge():
        print(f"error: {why_no_bridge()}", file=sys.stderr)
        return 2
    by_name = {fault.name: fault for fault in faults() if options.only in fault.name}

    def told(record: Record) -> str:
        return line(row_of(record), record.found.endpoint)

    def row_of(record: Record) -> Row:
        return Row(fault=by_name[record.task.fault], **record.found.values)

    with ExitStack() as left:

        @cache
        def chain() -> Chain:
            """The chain, which starts with the first row that is missing."""
            folder = left.enter_context(tempfile.TemporaryDirectory())
            return left.enter_context(Chain(Path(folder), options.seed))

        def perform(task: Task) -> Traced[Found]:
            return measured(chain(), by_name[task.fault])

        tasks = [Task(name, options.seed) for name in by_name]
        records = keeper.records(perform, tasks, FILE, told=told)
    lines = [*HEAD, *map(told, records)]
    robots = sum(record.found.contacts[0] for record in records)
    walls = sum(record.found.contacts[1] for record in records)
    text = summary([*map(row_of, records)], (robots, walls), options.seed)
    print(*lines, "", text, sep="\n")
    return 0


def measured(chain: Chain, fault: Fault) -> Traced[Found]:
    """The row of a fault; a run of real time has no bits."""
    before = chain.contacts
    row = play(chain, fault)
    robots, walls = chain.contacts
    values = {one.name: getattr(row, one.name) for one in fields(row) if one.name != "fault"}
    contacts = (robots - before[0], walls - before[1])
    return Traced(Found(values, chain.bridge.endpoint, contacts))


if __name__ == "__main__":
    raise SystemExit(main())
