"""`swarmctl view`: a living swarm on the terminal, or on a web page; a recording on the page."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.errors import SwarmError
from swarmd.operator.cli.options import EXISTING, CommonOptions, common_options
from swarmd.operator.cli.output import need_terminal, warn
from swarmd.operator.cli.web import WebOptions, check_web, serve, web_options
from swarmd.plugins import need, pattern_names

if TYPE_CHECKING:
    from swarmd.link.keys.identity import Identity
    from swarmd.operator.view.commander import LiveCommander
    from swarmd.operator.view.live import LiveSource


@click.command()
@click.argument("files", nargs=-1, metavar="[FILE]...", type=EXISTING)
@click.option("--web", is_flag=True, help="Serve a web page.")
@web_options
@common_options
def view(
    options: CommonOptions,
    files: tuple[Path, ...],
    web: bool,
    page: WebOptions,
) -> None:
    """Show a living swarm: map and list.

    The swarm is shown on this terminal, where keys stop all robots; with --web on a page with
    details and commands, whose address is printed. With FILE the page plays recordings instead: a
    merged recording, recordings of robots (.mcap), or a folder of recordings, such as `record
    fetch` makes.
    """
    if not web and (page.token or page.viewer_token or page.tls is not None):
        raise click.UsageError("--token, --viewer-token and --tls are for a page; add --web")
    if not web:
        if files:
            raise click.UsageError(f"{files[0]}: recordings are shown on a page; add --web")
        click.get_current_context().exit(_show(options))
    elif files:
        need("websockets", "mcap", "rosbags", extra="web,record")
        check_web(page)
        _play(files, page)
    else:
        need("websockets", extra="web")
        with _live(options, "from the page") as (source, commander, identity):
            # In a secured swarm the page gets a token, the certificate of this user's identity
            # (with --tls), and is read only unless this user is an operator.
            page = page.of(identity)
            check_web(page)
            serve(source, commander, page)


@contextmanager
def _live(
    options: CommonOptions, reason: str, *, with_patterns: bool = True
) -> Iterator[tuple[LiveSource, LiveCommander, Identity | None]]:
    """A context with the source of a living swarm, the commander of its pages, and the identity.

    `reason`: the text that robots store with an emergency stop from a page. `with_patterns`: a
    child process describes the patterns, for views that can start a run.
    """
    from swarmd.operator.cli.plugin_check import describe_patterns
    from swarmd.operator.session.targets import remember
    from swarmd.operator.view.commander import LiveCommander
    from swarmd.operator.view.live import LiveSource

    with options.operator() as operator:
        describe = partial(describe_patterns, (), None) if with_patterns else None
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
    from swarmd.operator.view.screen import Screen
    from swarmd.operator.view.terminal_view import TerminalView

    with (
        _live(options, "from a terminal view", with_patterns=False) as (source, commander, _),
        Screen() as screen,
    ):
        return asyncio.run(TerminalView(source, commander, screen).run())


def _play(files: tuple[Path, ...], page: WebOptions) -> None:
    from swarmd.operator.cli.plugin_check import describe_patterns
    from swarmd.operator.cli.record_merge import parts_of
    from swarmd.operator.view.recording_source import RecordingSource

    source = RecordingSource(parts_of(files))
    for note in source.timeline.notes:
        warn(note)

    def describe() -> None:
        with suppress(SwarmError):  # such as a platform of another machine: units are left out
            source.take_patterns(describe_patterns((), None, source.robots[0].platform))

    threading.Thread(target=describe, daemon=True).start()
    serve(source, None, page)
