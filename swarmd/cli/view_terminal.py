"""`swarmctl view` without `--web`: a living swarm on the terminal."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from swarmd.cli.options import CommonOptions


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


def show(options: CommonOptions) -> int:
    """Show the swarm until `q` or a signal; the exit code."""
    need_terminal("view", "see `swarmctl members`, or give --web")
    from swarmd.cli.known_robots import remember
    from swarmd.plugins import pattern_names
    from swarmd.view.commander import LiveCommander
    from swarmd.view.live import LiveSource
    from swarmd.view.screen import Screen
    from swarmd.view.terminal_view import TerminalView

    with options.operator() as operator:
        source = LiveSource(operator, sorted(pattern_names(None)))
        commander = LiveCommander(options.operator, source.expected, "from a terminal view")
        source.start()
        try:
            with Screen() as screen:
                return asyncio.run(TerminalView(source, commander, screen).run())
        finally:
            commander.close()
            source.close()
            remember(operator.settings, source.view)
