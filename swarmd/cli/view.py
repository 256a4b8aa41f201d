"""`swarmctl view`: a living swarm on the terminal, or on a web page; a recording on the page."""

from __future__ import annotations

from pathlib import Path

import click

from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import warn
from swarmd.cli.web import WebOptions, check_web, serve, web_options


@click.command()
@click.argument(
    "files", nargs=-1, metavar="[FILE]...", type=click.Path(exists=True, path_type=Path)
)
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
        from swarmd.cli.view_terminal import show

        if files:
            raise click.UsageError(f"{files[0]}: recordings are shown on a page; add --web")
        if page.token or page.viewer_token or page.tls:
            raise click.UsageError("--token, --viewer-token and --tls are for a page; add --web")
        click.get_current_context().exit(show(options))
    check_web(page)
    if files:
        _play(files, page)
        return
    from swarmd.plugins import pattern_names
    from swarmd.view.commander import LiveCommander
    from swarmd.view.live import LiveSource

    with options.operator() as operator:
        source = LiveSource(operator, sorted(pattern_names(None)))
        commander = LiveCommander(options.operator, source.expected)
        source.start()
        try:
            serve(source, commander, page)
        finally:
            commander.close()
            source.close()


def _play(files: tuple[Path, ...], page: WebOptions) -> None:
    from swarmd.cli.record_merge import parts_of
    from swarmd.view.recording_source import RecordingSource

    source = RecordingSource(parts_of(files))
    for note in source.notes:
        warn(note)
    serve(source, None, page)
