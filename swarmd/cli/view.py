"""`swarmctl view`: a living swarm on a web page."""

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

    With --web on a page, at the address that is printed. On another interface than loopback a token
    is required, and --tls keeps it secret.
    """
    if not web:
        raise click.UsageError("give --web")
    check_web()
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
