"""The address of a page, and the rights of a browser: tokens, hosts, and origins of other sites."""

from __future__ import annotations

import errno
import hmac
import os
import socket
from contextlib import suppress
from dataclasses import dataclass
from urllib.parse import urlsplit

from websockets.datastructures import Headers

from swarmd.core.errors import ConfigError, NetworkError
from swarmd.link.settings import is_loopback

LEAST_TOKEN = 8
"""Characters of a token, at least."""

HEADERS = {
    "Cache-Control": "no-cache",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:;"
        " connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
}
"""Headers of each file: only scripts of this server run, and no other site can embed the page."""


@dataclass(frozen=True, slots=True)
class Access:
    """The tokens of operators and of viewers, which a page must quote.

    With `is_read_only` no page may send commands. Without tokens each page may send commands, so
    `check_bind` lets such a server listen on loopback only. ConfigError for a token that is too
    short, for viewers' token without operators' token, and for equal tokens. `key`: the key of the
    swarm that all pages command with, and what it may; empty without keys.
    """

    operator: str = ""
    viewer: str = ""
    is_read_only: bool = False
    key: str = ""

    def __post_init__(self) -> None:
        for name, token in (("--token", self.operator), ("--viewer-token", self.viewer)):
            if token and (len(token) < LEAST_TOKEN or not token.isascii() or " " in token):
                raise ConfigError(
                    f"{name}: expected at least {LEAST_TOKEN} ASCII characters without blanks,"
                    " or - for a new one"
                )
        if self.viewer and not self.operator:
            raise ConfigError("--viewer-token: expected --token too, or pages without one command")
        if self.viewer and self.viewer == self.operator:
            raise ConfigError("--viewer-token is that of --token; expected another one")

    def role(self, token: str) -> str:
        """`operator`, `viewer`, or empty for a wrong token."""
        role = self._role(token)
        return "viewer" if role and self.is_read_only else role

    def _role(self, token: str) -> str:
        if not self.operator:
            return "operator"
        given = token.encode()
        if hmac.compare_digest(given, self.operator.encode()):
            return "operator"
        if self.viewer and hmac.compare_digest(given, self.viewer.encode()):
            return "viewer"
        return ""

    def check_bind(self, host: str) -> None:
        """ConfigError if other machines could command without a token."""
        if not self.operator and not is_loopback(host):
            raise ConfigError(
                f"--bind {host}: other machines could command the robots; expected a token"
                " (--token), or 127.0.0.1"
            )

    def allows(self, headers: Headers) -> bool:
        """False for a request that may come from a script of another site.

        A browser runs scripts of all sites, and their requests reach loopback. A request is refused

        1. if origin and host in the request differ,
        2. if this server has no token, and the host in the request is neither `localhost` nor a
           loopback address: a site can let its own host name point to loopback (DNS rebinding), so
           that origin and host agree.
        """
        try:
            origin = headers.get("Origin")
            host = headers.get("Host", "")
            if origin is not None and urlsplit(origin).netloc != host:
                return False
            return bool(self.operator) or is_loopback(urlsplit(f"//{host}").hostname or "")
        except (ValueError, LookupError):  # malformed, or given twice
            return False


def bearer_token(headers: Headers) -> str:
    """The token in the header `Authorization: Bearer TOKEN`; empty without one."""
    given = headers.get_all("Authorization")
    if len(given) != 1:
        return ""
    scheme, _, token = given[0].partition(" ")
    return token.strip() if scheme.lower() == "bearer" else ""


def check_address(host: str, port: int, access: Access) -> None:
    """ConfigError if the address needs a token, NetworkError if it cannot be used."""
    access.check_bind(host)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.create_server((host, port), family=family).close()
    except OSError as error:
        raise unusable(host, port, error) from error


def unusable(host: str, port: int, error: OSError) -> NetworkError:
    """The error for an address at which no server can listen, in one line."""
    why = (
        "is in use"
        if error.errno == errno.EADDRINUSE
        else f"cannot be used ({os.strerror(error.errno or 0)})"
    )
    return NetworkError(f"port {port} of {host} {why}; expected a free one, such as --port 0")


def page_url(scheme: str, host: str, port: int) -> str:
    """The address of the page of a server that is bound to `host`."""
    name = own_address() if host in ("0.0.0.0", "::") else host
    return f"{scheme}://{f'[{name}]' if ':' in name else name}:{port}/"


def own_address() -> str:
    """This machine's address in its network, for pages on other machines; else its host name."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
        probe.connect(("192.0.2.1", 9))  # sends nothing
        return str(probe.getsockname()[0])
    return socket.gethostname()
