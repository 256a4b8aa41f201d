"""Checks a certificate against its key and its authority, by Python's `ssl` module.

Every robot has this module. A robot without keys does not import it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swarmd.core.errors import ConfigError

if TYPE_CHECKING:
    import ssl  # 19 ms, for keys alone

_FLIGHTS = 10  # a handshake of TLS 1.3 takes three


@dataclass(frozen=True, slots=True)
class CertificateFacts:
    """The common name of a certificate, and when it ends, in s since 1970 (UTC)."""

    name: str
    expires: int


def check_certificate(certificate: Path, key: Path, authority: Path) -> CertificateFacts:
    """Read a certificate, and verify its key and the signature of the authority.

    `certificate`, `key`, `authority`: PEM files. The check is a TLS handshake in memory, as between
    the ends of a link: the server has certificate and key, the client trusts the authority.
    ConfigError in one line if they do not match. The wall clock must lie within the life of the
    authority: from 1970, the begin of every authority's life, to its end.
    """
    import ssl  # 19 ms, for keys alone

    try:
        server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        server.load_cert_chain(certificate, key, password=_no_passphrase)
        client = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        client.check_hostname = False
        client.load_verify_locations(authority)
        peer = _peer_of(client, server)
    except (ssl.SSLError, ValueError) as error:
        reason = getattr(error, "verify_message", "") or getattr(error, "reason", "") or error
        raise ConfigError(f"{certificate.name} does not fit its key or authority: {reason}") from (
            error
        )
    except OSError as error:
        raise ConfigError(f"{certificate}: {error.strerror}") from error
    # `ssl` gives the subject as a tuple of groups, each a tuple of (key, value).
    subject = dict(pair for group in peer["subject"] for pair in group)
    expires = ssl.cert_time_to_seconds(str(peer["notAfter"]))
    return CertificateFacts(name=str(subject.get("commonName", "")), expires=int(expires))


def _no_passphrase() -> str:
    raise ConfigError("the private key is encrypted; a daemon cannot ask for a passphrase")


def _peer_of(client: ssl.SSLContext, server: ssl.SSLContext) -> dict[str, Any]:
    """The server's certificate after the client has verified it. Raises SSLError."""
    import ssl  # 19 ms, for keys alone

    to_client = ssl.MemoryBIO()
    to_server = ssl.MemoryBIO()
    ends = (
        client.wrap_bio(to_client, to_server),
        server.wrap_bio(to_server, to_client, server_side=True),
    )
    for _ in range(_FLIGHTS):
        for end in ends:
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                continue  # this end waits for the other end
    return dict(ends[0].getpeercert() or {})
