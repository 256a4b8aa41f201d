"""`swarmctl view`: a living swarm on the terminal, or on a web page."""

from __future__ import annotations

import click

from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.web import WebOptions, check_web, serve, web_options


@click.command()
@click.option("--web", is_flag=True, help="Serve a web page.")
@web_options
@common_options
def view(options: CommonOptions, web: bool, page: WebOptions) -> None:
    """Show a living swarm: map, list, details and commands.

    On this terminal, where `?` lists the keys; with --web on a page whose address is printed.
    """
    if not web:
        from swarmd.cli.view_terminal import show

        if page.token or page.viewer_token or page.tls:
            raise click.UsageError("--token, --viewer-token and --tls are for a page; add --web")
        click.get_current_context().exit(show(options))
    check_web(page)
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
