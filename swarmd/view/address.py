"""The address of a page: whether it can be used, and by what name others reach it."""

from __future__ import annotations

import errno
import os
import socket
from contextlib import suppress

from swarmd.core.errors import NetworkError
from swarmd.view.access import Access


def check_address(host: str, port: int, access: Access) -> None:
    """ConfigError if the address needs a token, NetworkError if it cannot be used."""
    access.check_bind(host)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.create_server((host, port), family=family).close()
    except OSError as error:
        raise unusable(host, port, error) from error


def unusable(host: str, port: int, error: OSError) -> NetworkError:
    """The error of an address at which no server can listen, in one line."""
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
    """The address of this machine in its network, for pages on others; else its name."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
        probe.connect(("192.0.2.1", 9))  # sends nothing
        return str(probe.getsockname()[0])
    return socket.gethostname()
