"""The identity of a robot, operator or viewer: a folder with its certificate and keys.

The files, readable only by the owner, are `identity.json`, `certificate.pem`, `key.pem`,
`authority.pem` and `roster`. Reading them needs no cryptography.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from swarmd.core.bounds import Id
from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.files import leads_nowhere, read_regular, write_whole
from swarmd.link.keys.datagram_keys import DatagramKeys
from swarmd.link.keys.roster import PublicKey, Role, Roster, read_roster, stored_roster

INFO = "identity.json"
CERTIFICATE = "certificate.pem"
KEY = "key.pem"
AUTHORITY = "authority.pem"
ROSTER = "roster"
SYSTEM_FOLDER = Path("/etc/swarmd/identities")
_MODE_OF_OTHERS = 0o077  # permissions of group and others
Pem = Annotated[bytes, Meta(min_length=1, max_length=8192)]


class IdentityInfo(Struct, frozen=True, kw_only=True):
    """The content of `identity.json`. `expires`: end of the certificate, s since 1970 (UTC)."""

    swarm: Id
    name: Id
    role: Role
    expires: int
    authority: PublicKey


class RosterFile(Struct, frozen=True, array_like=True):
    """The signed roster and the keys of its generation: one file, since they change together."""

    roster: bytes
    datagram_keys: DatagramKeys


class Issued(Struct, frozen=True, kw_only=True):
    """An identity as the authority issues it: certificate, private key, roster and keys."""

    info: IdentityInfo
    certificate: Pem
    key: Pem
    authority: Pem
    roster: RosterFile

    def write(self, folder: Path) -> None:
        """Write the files of the identity, `identity.json` last: it marks a complete identity."""
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_private(folder / CERTIFICATE, self.certificate)
        write_private(folder / KEY, self.key)
        write_private(folder / AUTHORITY, self.authority)
        write_roster(folder, self.roster)
        write_private(folder / INFO, msgspec.json.encode(self.info))


class Identity(Struct, frozen=True):
    """A name of a swarm with the keys and certificates that prove the name."""

    folder: Path
    info: IdentityInfo
    roster: Roster
    datagram_keys: DatagramKeys
    signed_roster: bytes = b""  # the roster as it is handed to others

    @property
    def name(self) -> str:
        """The name in its certificate."""
        return self.info.name

    @property
    def role(self) -> Role:
        """The role of the name, which decides its permissions."""
        return self.info.role

    @property
    def certificate(self) -> Path:
        """The certificate, PEM."""
        return self.folder / CERTIFICATE

    @property
    def key(self) -> Path:
        """The private key, PEM."""
        return self.folder / KEY

    @property
    def authority(self) -> Path:
        """The certificate of the authority, PEM."""
        return self.folder / AUTHORITY


def authority_of(identity: Identity | None) -> bytes:
    """The public key of the swarm's authority; empty for an insecure swarm."""
    return b"" if identity is None else identity.info.authority


def user_folder(environ: Mapping[str, str] = os.environ) -> Path | None:
    """The folder of this user's configuration (XDG base directories); None without a home."""
    base = environ.get("XDG_CONFIG_HOME", "")
    home = environ.get("HOME", "")
    if os.path.isabs(base):
        return Path(base) / "swarmd"
    return Path(home) / ".config/swarmd" if os.path.isabs(home) else None


def identity_folders(swarm: str, environ: Mapping[str, str] = os.environ) -> tuple[Path, ...]:
    """The folders that may contain an identity for a swarm: of the user, then of the machine."""
    user = user_folder(environ)
    system = SYSTEM_FOLDER / swarm
    return (system,) if user is None else (user / "identities" / swarm, system)


class Installed(Struct, frozen=True):
    """What is known of the installed identity for a swarm; all None: there is none.

    `folder`: the folder of the identity, which may be damaged. `hidden`: why a folder that may
    contain one cannot be looked into, in one line.
    """

    folder: Path | None = None
    hidden: str | None = None


def installed_identity(swarm: str, environ: Mapping[str, str] = os.environ) -> Installed:
    """Where the identity of this user or machine for a swarm is installed."""
    hidden = None
    for folder in identity_folders(swarm, environ):
        try:
            if _holds_identity(folder):
                return Installed(folder, hidden)
        except OSError as error:
            hidden = hidden or f"{folder}: {error.strerror}"
    return Installed(hidden=hidden)


def _holds_identity(folder: Path) -> bool:
    """True if an identity is in a folder, or was: also one whose files cannot be read, or lack.

    OSError if it cannot be known.
    """
    try:
        found = os.lstat(folder)
    except (FileNotFoundError, NotADirectoryError) as error:
        if leads_nowhere(folder.parent):
            raise FileNotFoundError(error.errno, "a link above it leads nowhere") from error
        return False
    if not stat.S_ISDIR(found.st_mode) and not folder.is_dir():
        return True  # a file, or a link that leads nowhere, such as to a drive that is not there
    try:
        return not {INFO, CERTIFICATE, KEY, ROSTER}.isdisjoint(os.listdir(folder))
    except PermissionError:
        return True


def find_identity(swarm: str, environ: Mapping[str, str] = os.environ) -> Identity | None:
    """The identity of this user or machine for a swarm, or None; errors as `load_identity`.

    ConfigError also if it cannot be known whether there is one.
    """
    installed = installed_identity(swarm, environ)
    if installed.folder is not None:
        return load_identity(installed.folder)
    if installed.hidden is not None:
        raise ConfigError(
            f"{installed.hidden}: there may be an identity for swarm {swarm}; make the folder"
            " readable, or give --identity, or --insecure if the swarm has no keys"
        )
    return None


def choose_identity(
    swarm: str, folder: Path | None, *, insecure: bool, environ: Mapping[str, str] = os.environ
) -> Identity | None:
    """The identity in `folder`; `folder` None: the installed identity for the swarm.

    None if no identity is installed, or with `insecure`. ConfigError in one line if `insecure` and
    `folder` are both given, if the identity cannot be read, or if it belongs to another swarm.
    """
    if insecure and folder is not None:
        raise ConfigError("identity and insecure exclude each other; give one of them")
    if insecure:
        return None
    identity = find_identity(swarm, environ) if folder is None else load_identity(folder)
    if identity is not None and identity.info.swarm != swarm:
        raise ConfigError(
            f"identity {identity.folder} is of swarm {identity.info.swarm!r}, not of {swarm!r};"
            f" give the swarm {identity.info.swarm}, or another identity"
        )
    return identity


def check_asker(identity: Identity | None) -> None:
    """Raise ConfigError for the identity of a robot: robots do not answer questions of robots."""
    if identity is not None and identity.role is Role.ROBOT:
        raise ConfigError(
            f"identity {identity.folder} is of the robot {identity.name}; swarmctl needs that of an"
            " operator or a viewer (--identity)"
        )


def load_identity(folder: Path) -> Identity:
    """Read the identity (certificate, private key, roster, datagram keys) in a folder.

    ConfigError in one line if a file is missing or damaged, if files do not belong together, or if
    other users can read the private key or the roster's file, which has datagram keys.
    """
    try:
        info = msgspec.json.decode(_read(folder / INFO), type=IdentityInfo)
        stored = msgspec.msgpack.decode(_read(folder / ROSTER), type=RosterFile)
        # The roster was verified when it was written. A process that can change this file can also
        # change the authority's key, and the check would take swarmctl 20 ms at each start.
        roster = stored_roster(stored.roster)
        for name in (CERTIFICATE, KEY, AUTHORITY):
            _read(folder / name)  # OSError for a missing file
        open_to_others = [
            folder / name
            for name in (KEY, ROSTER)
            if stat.S_IMODE((folder / name).stat().st_mode) & _MODE_OF_OTHERS
        ]
    except OSError as error:
        raise ConfigError(f"identity {folder}: {error.strerror}: {error.filename}") from error
    except (ValueError, RecursionError, CodecError) as error:
        raise ConfigError(f"identity {folder}: {error}; install its bundle again") from error
    if open_to_others:
        path = open_to_others[0]
        raise ConfigError(f"{path} can be read by others; run: chmod 600 {path}")
    keys = stored.datagram_keys
    if roster.swarm != info.swarm or keys.generation != roster.generation:
        raise ConfigError(f"identity {folder}: its files do not belong together; install it again")
    return Identity(folder, info, roster, keys, stored.roster)


def _read(path: Path) -> bytes:
    """The content of a file. OSError for a device or a pipe, whose content may never end.

    If this process runs as root, a symbolic link is followed only in a folder that root owns:
    another account could make a link to any file.
    """
    is_foreign = os.geteuid() == 0 and path.parent.stat().st_uid != 0
    return read_regular(path, flags=os.O_NOFOLLOW if is_foreign else 0)


def as_of(identity: Identity, file: RosterFile) -> Identity:
    """A copy of the identity with another roster, in memory. CodecError if it is not valid."""
    roster = read_roster(file.roster, identity.info.authority)
    return replace(
        identity, roster=roster, datagram_keys=file.datagram_keys, signed_roster=file.roster
    )


def write_roster(folder: Path, roster: RosterFile) -> None:
    """Replace the roster and the keys of its generation."""
    write_private(folder / ROSTER, msgspec.msgpack.encode(roster))


def write_private(path: Path, content: bytes) -> None:
    """Write a file to disk that only the owner can read, whole or not at all."""
    write_whole(path, content, 0o600)
