"""Progress and result of a fetch, as `record fetch` and `incidents fetch` print them."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, NoReturn

import click

from swarmd.operator.cli.options import CommonOptions
from swarmd.operator.cli.output import print_json, print_table, rewrite
from swarmd.operator.texts.values import megabytes

if TYPE_CHECKING:
    from swarmd.operator.verbs.record.ask import Fetched


def print_fetched(options: CommonOptions, fetched: Fetched) -> NoReturn:
    """Print the copies of a fetch and end with its exit code."""
    if sys.stderr.isatty():
        rewrite("")  # clears the line of progress
    if options.is_json:
        print_json("Fetched", fetched.as_json())
    else:
        rows = [
            (one.robot, str(one.path), megabytes(one.size, 2), one.state) for one in fetched.files
        ]
        print_table(("NAME", "FILE", "SIZE", "COPY"), rows)
    click.get_current_context().exit(fetched.exit_code)


def tell_bytes(robot: str, name: str, received: int, size: int) -> None:
    """Show how much of a file has come, on a terminal."""
    if sys.stderr.isatty():
        rewrite(f"{robot} {name}: {megabytes(received, 2)} of {megabytes(size, 2)}")
