"""Sessions that listen where their makers say: one endpoint, port 0 for a free one."""

from __future__ import annotations

import re
import socket
from collections.abc import Mapping

import zenoh

from swarmd.errors import ConfigError, NetworkError, SwarmError
from swarmd.network.session import open_with

_TRIES = 5
_ENDPOINT = re.compile(r"tcp/([^:]+|\[[^]]+\]):(\d+)")


def open_listening(
    endpoint: str, options: Mapping[str, object], what: str
) -> tuple[zenoh.Session, str]:
    """A session with Zenoh's own option paths that listens at `endpoint`, and where that is.

    NetworkError names `what` it was for if the endpoint cannot be had, ConfigError if it is none.
    """
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None or int(match[2]) > 65535:
        raise ConfigError(f"endpoint is {endpoint!r}; wanted is such as tcp/127.0.0.1:0")
    if int(match[2]):
        return open_with({**options, "listen/endpoints": [endpoint]}, what), endpoint
    for _ in range(_TRIES):
        chosen = f"tcp/{match[1]}:{_free_port(match[1].strip('[]'), what)}"
        try:
            return open_with({**options, "listen/endpoints": [chosen]}, what), chosen
        except NetworkError:  # another took it in between
            continue
    raise NetworkError(f"no free port for {what} at {endpoint}")


def _free_port(host: str, what: str) -> int:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        try:
            probe.bind((host, 0))
        except OSError as error:
            raise SwarmError(f"no port at {host} for {what}: {error}") from error
        return int(probe.getsockname()[1])
