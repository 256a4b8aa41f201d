"""What a verb that draws on the terminal needs of it."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Iterator

import click


def need_terminal(verb: str, instead: str) -> None:
    """UsageError if the verb cannot draw here: no terminal, or one without a cursor."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise click.UsageError(f"{verb} needs a terminal; {instead}")
    if os.environ.get("TERM", "dumb") == "dumb":
        raise click.UsageError(f"{verb} needs a terminal whose cursor moves (TERM); {instead}")


@contextlib.contextmanager
def signals_end() -> Iterator[None]:
    """SIGTERM and SIGHUP raise SystemExit within, with 128 and their number."""

    def end(number: int, _: object) -> None:
        raise SystemExit(128 + number)

    before = {number: signal.signal(number, end) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
