"""`swarmctl view`: a living swarm on a web page."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import signal
import ssl
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import warn

if TYPE_CHECKING:
    from swarmd.view.server import Access, Commander
    from swarmd.view.source import Source

PORT = 8080


@click.command()
@click.option("--web", is_flag=True, help="Serve a web page.")
@click.option("--bind", default="127.0.0.1", metavar="ADDRESS", help="Where to listen [127.0.0.1].")
@click.option("--port", type=click.IntRange(0, 65535), default=PORT, help="0: any [8080].")
@click.option(
    "--token", metavar="TEXT", help="What an operator's address must hold; `-`: a new one."
)
@click.option("--viewer-token", metavar="TEXT", help="The same for pages that may only look.")
@click.option(
    "--tls",
    nargs=2,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="CERTIFICATE KEY",
    help="Serve by https.",
)
@common_options
def view(
    options: CommonOptions,
    web: bool,
    bind: str,
    port: int,
    token: str | None,
    viewer_token: str | None,
    tls: tuple[Path, Path] | None,
) -> None:
    """Show a living swarm: map, list, details and commands.

    With --web on a page, at the address that is printed. On another interface than loopback a token
    is required, and --tls keeps it secret.
    """
    if not web:
        raise click.UsageError("give --web")
    from swarmd.plugins import pattern_names
    from swarmd.view.commander import LiveCommander
    from swarmd.view.live import LiveSource
    from swarmd.view.server import Access

    access = Access(_token(token), _token(viewer_token))
    with options.operator() as operator:
        source = LiveSource(operator, sorted(pattern_names(None)))
        commander = LiveCommander(options.operator, source.expected)
        source.start()
        try:
            asyncio.run(serve(source, commander, access, bind, port, tls))
        finally:
            commander.close()
            source.close()


async def serve(
    source: Source,
    commander: Commander | None,
    access: Access,
    bind: str,
    port: int,
    tls: tuple[Path, Path] | None = None,
) -> None:
    """Serve a page until Ctrl-C or SIGTERM."""
    from swarmd.view.server import ViewServer

    context = None
    if tls is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        try:
            context.load_cert_chain(*tls)
        except (ssl.SSLError, OSError) as error:
            raise click.UsageError(f"--tls {tls[0]} {tls[1]}: {error}") from error
    ending = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ending.set)
    server = ViewServer(source, commander, access)
    address = await server.start(bind, port, context)
    try:
        for role, secret in (("page", access.operator), ("read only", access.viewer)):
            if secret or role == "page":
                click.echo(f"{role}: {address}{f'?token={secret}' if secret else ''}")
        warn("Ctrl-C ends it")
        with contextlib.suppress(asyncio.CancelledError):
            await ending.wait()
    finally:
        await server.close()


def _token(text: str | None) -> str:
    return secrets.token_urlsafe(12) if text == "-" else text or ""
