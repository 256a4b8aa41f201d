"""Options of a web page, and its server: for `view`, `demo`, `sim up` and `exp view`."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import secrets
import signal
import ssl
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from swarmd.core.errors import ConfigError, R
from swarmd.link.keys.roster import Role
from swarmd.operator.cli.output import warn
from swarmd.operator.texts.keys import key_text
from swarmd.plugins import need

if TYPE_CHECKING:
    from swarmd.link.keys.identity import Identity
    from swarmd.operator.view.access import Access
    from swarmd.operator.view.server import Commander, ViewServer
    from swarmd.operator.view.source import Source

HOST = "127.0.0.1"
PORT = 8080
TOKEN_BYTES = 12
MAX_TOKEN = 200  # characters that are read of a file
_START_TIME = 10.0  # s
ENDED = "The server has ended."

_OPTIONS = (
    click.option("--bind", default=HOST, metavar="ADDRESS", help=f"Where to listen [{HOST}]."),
    click.option("--port", type=click.IntRange(0, 65535), default=PORT, help="0: any [8080]."),
    click.option(
        "--token",
        metavar="FILE",
        help="What an operator's address must contain: the first line of this file; `-`: a new one."
        " Other interfaces than loopback require it. In a secured swarm a page without this option"
        " makes one.",
    ),
    click.option("--viewer-token", metavar="FILE", help="The same for read-only pages."),
    click.option(
        "--tls",
        is_flag=False,
        flag_value="",
        metavar="[CERTIFICATE,KEY]",
        help="Serve by https, with these files or with the certificate of your identity.",
    ),
)


@dataclass(frozen=True, slots=True)
class WebOptions:
    """The address of a page, its tokens and its certificate; an empty token counts as absent.

    `tls`: the files of certificate and key; None: no TLS. Empty for `--tls` without files: `of`
    then takes the files of the identity. `is_read_only`: no page may send commands. `key`: with
    whose key pages command, and what it may.
    """

    bind: str
    port: int
    token: str = ""
    viewer_token: str = ""
    tls: tuple[Path, Path] | tuple[()] | None = None
    is_read_only: bool = False
    key: str = ""

    @property
    def access(self) -> Access:
        """The tokens and what they permit."""
        from swarmd.operator.view.access import Access

        return Access(self.token, self.viewer_token, self.is_read_only, self.key)

    def of(self, identity: Identity | None) -> WebOptions:
        """These options for a page of a swarm in which this user is `identity`.

        With an identity the page gets a token, since every user of this computer can open it.
        """
        if identity is None:
            return self
        return replace(
            self,
            token=self.token or secrets.token_urlsafe(TOKEN_BYTES),
            tls=(identity.certificate, identity.key) if self.tls == () else self.tls,
            is_read_only=identity.role is Role.VIEWER,
            key=key_text(identity),
        )

    def context(self) -> ssl.SSLContext | None:
        """The certificate; ConfigError if it cannot be used."""
        if self.tls is None:
            return None
        if not self.tls:
            raise ConfigError("--tls: there is no identity here; give CERTIFICATE,KEY")
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        try:
            context.load_cert_chain(*self.tls)
        except (ssl.SSLError, OSError) as error:
            raise ConfigError(
                f"--tls {self.tls[0]},{self.tls[1]}: {error}; expected PEM files"
            ) from error
        return context


def web_options(function: Callable[..., R]) -> Callable[..., R]:
    """Give a verb the options of a page, as the parameter `page`."""

    @functools.wraps(function)
    def wrapper(
        *args: Any,
        bind: str,
        port: int,
        token: str | None,
        viewer_token: str | None,
        tls: str | None,
        **kwargs: Any,
    ) -> R:
        if viewer_token and not token:
            token = "-"  # without a token anyone could command from the page
        tokens = _token("--token", token), _token("--viewer-token", viewer_token)
        web = WebOptions(bind, port, *tokens, _files(tls))
        return function(*args, page=web, **kwargs)

    for option in reversed(_OPTIONS):
        wrapper = option(wrapper)
    return wrapper


def check_web(web: WebOptions) -> None:
    """Raise before anything has started: PluginError for a missing library, else as `serve`."""
    need("websockets", extra="web")
    from swarmd.operator.view.access import check_address

    check_address(web.bind, web.port, web.access)
    web.context()


def serve(source: Source, commander: Commander | None, web: WebOptions) -> None:
    """Serve a page until Ctrl-C or SIGTERM.

    NetworkError if the port is in use; ConfigError if a required token or certificate is missing.
    """
    asyncio.run(_serve(source, commander, web))


async def _serve(source: Source, commander: Commander | None, web: WebOptions) -> None:
    ending = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ending.set)
    server = await _started(source, commander, web, click.echo)
    warn("Ctrl-C ends it")
    await ending.wait()
    await server.close(ENDED)


class Served:
    """A page that a thread serves until `close`, while the program does other work.

    `reason`: the text that the page shows after the end of the server. `addresses`: lines with the
    addresses of the page, which go to standard error: standard output belongs to the program.
    """

    def __init__(
        self, source: Source, commander: Commander | None, web: WebOptions, reason: str = ENDED
    ) -> None:
        """NetworkError if the port is in use."""
        self.reason = reason
        self.addresses: list[str] = []
        self._loop = asyncio.new_event_loop()
        self._server: ViewServer | None = None
        self._thread = threading.Thread(target=self._loop.run_forever, name="page", daemon=True)
        self._thread.start()
        try:
            started = _started(source, commander, web, self.addresses.append)
            self._server = asyncio.run_coroutine_threadsafe(started, self._loop).result(_START_TIME)
            for line in self.addresses:
                warn(line)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the server; its pages show `reason`."""
        if self._server is not None:
            closing = self._server.close(self.reason)
            asyncio.run_coroutine_threadsafe(closing, self._loop).result(_START_TIME)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_START_TIME)
        self._loop.close()


async def _started(
    source: Source, commander: Commander | None, web: WebOptions, on_address: Callable[[str], None]
) -> ViewServer:
    """A server that listens; `on_address` takes a line for each address of its page."""
    from swarmd.link.settings import is_loopback
    from swarmd.operator.view.server import ViewServer

    server = ViewServer(source, commander, web.access)
    address = await server.start(web.bind, web.port, web.context())
    first = "read only" if web.is_read_only else "page"
    on_address(f"{first}: {address}{f'?token={web.token}' if web.token else ''}")
    if web.key and not web.is_read_only:
        warn(
            f"who opens it commands with the key of {web.key}; for a page that may less:"
            " `swarmctl keys issue`, then view --web --identity FOLDER"
        )
    if web.viewer_token:
        on_address(f"read only: {address}?token={web.viewer_token}")
    if web.tls is None and not is_loopback(web.bind):
        warn("without --tls others in this network can read the tokens and what the page shows")
    return server


def _files(text: str | None) -> tuple[Path, Path] | tuple[()] | None:
    """The files of `--tls`; UsageError if there is one only."""
    if not text:
        return None if text is None else ()
    certificate, comma, key = text.partition(",")
    if not (certificate and comma and key):
        raise click.UsageError(f"--tls is {text!r}; expected CERTIFICATE,KEY, or nothing")
    return Path(certificate), Path(key)


def _token(option: str, source: str | None) -> str:
    """A new token for `-`, else the first line of the file `source`; empty without a source.

    UsageError without `source` if the file is absent or empty: the word may be a token.
    """
    if source == "-" or not source:
        return secrets.token_urlsafe(TOKEN_BYTES) if source else ""
    token = ""
    with contextlib.suppress(OSError, ValueError), open(source, encoding="utf-8") as file:
        token = file.readline(MAX_TOKEN).strip()
    if not token:
        raise click.UsageError(
            f"{option}: expected -, or a file whose first line is the token; all users and programs"
            " of this computer can read the words of a command (ps)"
        )
    return token
