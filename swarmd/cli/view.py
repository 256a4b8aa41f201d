"""`swarmctl view`: a living swarm on the terminal, or on a web page; a recording on the page."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.cli.options import EXISTING, CommonOptions, common_options
from swarmd.cli.output import need_terminal, warn
from swarmd.cli.web import WebOptions, check_web, serve, web_options
from swarmd.plugins import need, pattern_names

if TYPE_CHECKING:
    from swarmd.security.identity import Identity
    from swarmd.view.commander import LiveCommander
    from swarmd.view.live import LiveSource


@click.command()
@click.argument("files", nargs=-1, metavar="[FILE]...", type=EXISTING)
@click.option("--web", is_flag=True, help="Serve a web page.")
@web_options
@common_options
def view(options: CommonOptions, files: tuple[Path, ...], web: bool, page: WebOptions) -> None:
    """Show a living swarm: map, list, details and commands.

    On this terminal, where `?` lists the keys; with --web on a page whose address is printed. With
    FILE the page plays recordings instead: a merged one, or those of robots (.mcap), or a folder of
    them, such as `record fetch` makes.
    """
    if not web:
        if files:
            raise click.UsageError(f"{files[0]}: recordings are shown on a page; add --web")
        if page.token or page.viewer_token or page.tls is not None:
            raise click.UsageError("--token, --viewer-token and --tls are for a page; add --web")
        click.get_current_context().exit(_show(options))
    if files:
        need("websockets", "mcap", "rosbags", extra="web,record")
        check_web(page)
        _play(files, page)
        return
    need("websockets", extra="web")
    with _live(options, "from the page") as (source, commander, identity):
        page = page.of(identity)
        check_web(page)
        serve(source, commander, page)


@contextmanager
def _live(
    options: CommonOptions, reason: str
) -> Iterator[tuple[LiveSource, LiveCommander, Identity | None]]:
    """The swarm as views show it, and what carries their commands out; latches keep `reason`."""
    from swarmd.cli.plugin_check import describe_patterns
    from swarmd.client.known_robots import remember
    from swarmd.view.commander import LiveCommander
    from swarmd.view.live import LiveSource

    with options.operator() as operator:
        describe = partial(describe_patterns, (), None)
        source = LiveSource(operator, sorted(pattern_names(None)), describe)
        commander = LiveCommander(options.operator, source.expected, reason)
        source.start()
        try:
            yield source, commander, operator.identity
        finally:
            commander.close()
            source.close()
            remember(operator.settings, source.view)


def _show(options: CommonOptions) -> int:
    """Show the swarm on the terminal until `q` or a signal; the exit code."""
    need_terminal("view", "see `swarmctl members`, or give --web")
    from swarmd.view.screen import Screen
    from swarmd.view.terminal_view import TerminalView

    with _live(options, "from a terminal view") as (source, commander, _), Screen() as screen:
        return asyncio.run(TerminalView(source, commander, screen).run())


def _play(files: tuple[Path, ...], page: WebOptions) -> None:
    from swarmd.cli.record_merge import parts_of
    from swarmd.view.recording_source import RecordingSource

    source = RecordingSource(parts_of(files))
    for note in source.timeline.notes:
        warn(note)
    serve(source, None, page)
