"""The certificate authority of a swarm, in a folder on an operator's machine.

Certificates are X.509 with ECDSA P-256 (RFC 5280, FIPS 186-5). The common name is the name on the
roster. The extended key usage permits both ends of a TLS link (server and client). Certificates are
valid from 1970 on: the clock of a robot without a battery is in the past after a boot.
"""

from __future__ import annotations

import datetime
import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.files import lock_file, read_regular
from swarmd.core.keys import check_id
from swarmd.link.keys import datagram_keys
from swarmd.link.keys.content_signature import Purpose, sign
from swarmd.link.keys.identity import IdentityInfo, Issued, RosterFile, write_private
from swarmd.link.keys.private_keys import load_key, pem_of, public_bytes
from swarmd.link.keys.roster import (
    KeyPermit,
    Role,
    Roster,
    digest_of,
    encode_roster,
    pack_roster,
    read_roster,
)

KEY = "authority.key"
CERTIFICATE = "authority.pem"
STATE = "state"
NAMES = "names"
LOCK = "lock"
DAYS = 90
"""How long certificates of names are valid, unless stated otherwise."""
AUTHORITY_DAYS = 3650
MAX_PAST = 64
"""Earlier generations of which the authority keeps the secrets, to reach robots that hold them."""
_BEGIN = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)


class Generation(Struct, frozen=True, array_like=True):
    """A signed roster, and the secret of the swarm for the roster's generation."""

    secret: bytes
    roster: bytes


class IssueRecord(Struct, frozen=True, array_like=True):
    """The newest certificate and roster of a name, as the authority knows them."""

    expires: int  # the end of the newest certificate, in s since 1970
    generation: int  # of the newest roster that the name has for certain


class AuthorityState(Struct, frozen=True, kw_only=True):
    """The state of an authority that changes, without private keys: one file, replaced whole."""

    master: bytes  # the secret from which the answer secrets of robots derive
    days: float  # the life of new certificates
    now: Generation
    past: tuple[Generation, ...] = ()  # the newest is the last
    issued: dict[str, IssueRecord] = {}  # by name
    revoked: dict[str, int] = {}  # by removed name, the end of its last certificate, s since 1970


class Authority:
    """The authority in `folder`; `create` makes a new authority. ConfigError if it is unreadable.

    Several processes may change an authority: each change takes a lock, and reads the state that
    the last change has written. `roster`: the roster that this process read or made last.
    """

    def __init__(self, folder: Path, passphrase: bytes | None = None) -> None:
        self.folder = folder
        self._passphrase = passphrase
        self._key = load_key(folder / KEY, passphrase)
        self.public_key = public_bytes(self._key.public_key())
        try:
            self._certificate = x509.load_pem_x509_certificate(read_regular(folder / CERTIFICATE))
        except OSError as error:
            raise ConfigError(f"authority {folder}: {error.strerror}: {error.filename}") from error
        except ValueError as error:
            raise ConfigError(f"authority {folder}: {error}") from error
        self._state, self.roster = self._read_state()

    @classmethod
    def create(
        cls, folder: Path, swarm: str, passphrase: bytes | None = None, *, days: float = DAYS
    ) -> Authority:
        """Make an authority in a new folder, with an empty roster; `change` adds names.

        The passphrase encrypts the private keys of the authority and of the names in its folder.
        Without a passphrase these keys are not encrypted. The file STATE has the secrets from which
        the keys of datagrams derive. It is never encrypted: only mode 0600 protects it. `days`: the
        life of new certificates. ConfigError if the folder exists.
        """
        # 1. The folder, and a certificate that the authority signs itself.
        check_id(swarm, "swarm")
        try:
            folder.mkdir(parents=True, mode=0o700)
        except FileExistsError:
            raise ConfigError(f"{folder} is there already; remove it to begin anew") from None
        key = ec.generate_private_key(ec.SECP256R1())
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"swarmd authority of {swarm}")])
        until = _now() + datetime.timedelta(days=AUTHORITY_DAYS)
        certificate = (
            _builder(name, name, key.public_key(), until)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .sign(key, hashes.SHA256())
        )

        # 2. An empty roster, and the secrets from which the keys of datagrams derive: `secret` is
        # new with each generation of the roster, `master` stays.
        secret = os.urandom(datagram_keys.SECRET_BYTES)
        roster = Roster(swarm=swarm, generation=1, secret_digest=digest_of(secret))
        content = encode_roster(roster)
        signed = pack_roster(content, sign(key, Purpose.ROSTER, content))
        state = AuthorityState(
            master=os.urandom(datagram_keys.SECRET_BYTES), days=days, now=Generation(secret, signed)
        )

        # 3. The files. KEY comes last: a folder without KEY counts as no authority.
        write_private(folder / STATE, msgspec.msgpack.encode(state))
        write_private(folder / CERTIFICATE, certificate.public_bytes(serialization.Encoding.PEM))
        write_private(folder / KEY, pem_of(key, passphrase))
        return cls(folder, passphrase)

    def change(
        self,
        *,
        add: Mapping[str, Role] | None = None,
        remove: Collection[str] = (),
        permits: Mapping[str, KeyPermit] | None = None,
    ) -> Roster:
        """Write the next generation of the roster, with a new secret for datagrams.

        `permits`: by name, a new permit, whose `key` this method sets. The name is new, or has an
        earlier permit, which the new one replaces.

        ConfigError for an added name that is on the roster, and for a removed name that the roster
        lacks. ConfigError also for an added name whose earlier certificate was revoked and has not
        ended: the roster would make this certificate valid again.
        """
        with self._locked():
            self._state, self.roster = self._read_state()
            given = dict(permits or {})
            known = self.roster.permits
            new = {name: Role.PERMIT for name in given if name not in known}
            return self._change(dict(add or {}) | new, remove, given)

    def _change(
        self, add: dict[str, Role], remove: Collection[str], permits: Mapping[str, KeyPermit]
    ) -> Roster:
        """As `change`, with the lock held and the present state read."""
        # 1. The roster of the next generation, with a new secret for datagrams.
        self._check_change(add, remove)
        self._remove_keys(add)  # the keys of an earlier holder of the name
        secret = os.urandom(datagram_keys.SECRET_BYTES)
        old = self.roster
        roles = {name: old.role_of(name) for name in old.names if name not in remove} | add
        roster = self._next_roster(roles, secret, {**old.permits, **permits})
        content = encode_roster(roster)
        signed = pack_roster(content, sign(self._key, Purpose.ROSTER, content))

        # 2. The state: the certificates of removed names count as revoked until they end.
        issued = dict(self._state.issued)
        state = self._state
        newly_revoked = {name: issued.pop(name).expires for name in remove if name in issued}
        revoked = {name: end for name, end in state.revoked.items() if name not in add}
        past = (*state.past, state.now)[-MAX_PAST:]
        now = Generation(secret, signed)
        self._store(
            replace(state, now=now, past=past, issued=issued, revoked=revoked | newly_revoked)
        )
        self._remove_keys(remove)
        self.roster = roster
        return roster

    def _check_change(self, add: Collection[str], remove: Collection[str]) -> None:
        """Raise ConfigError as `change`."""
        roster = self.roster
        for name in add:
            check_id(name, "name")
            if roster.role_of(name) is not None:
                raise ConfigError(f"{name} is on the roster already, as {roster.role_of(name)}")
            expires = self._state.revoked.get(name, 0)
            if expires > _now().timestamp():
                day = datetime.datetime.fromtimestamp(expires, datetime.UTC).date()
                raise ConfigError(
                    f"{name} was revoked, and its last certificate ends on {day}; take another name"
                )
        for name in remove:
            if roster.role_of(name) is None:
                raise ConfigError(f"{name} is not on the roster of {roster.swarm}")

    def _next_roster(
        self,
        roles: Mapping[str, Role | None],
        secret: bytes,
        permits: Mapping[str, KeyPermit],
    ) -> Roster:
        """The roster of the next generation, with names and `roles`; a role None: not on it.

        `secret`: of the swarm, for this generation. The roster has only the digest of the secret,
        and of the datagram keys of each name that is no robot. By the digest, the receiver checks a
        secret or keys that a robot hands over. `permits`: by name, at least of each name with the
        role PERMIT. Such a name is in no other field that gives a right: robots of version 0.2 do
        not know the field `permits`, and would take the name for an operator or viewer.
        """
        old = self.roster
        generation = self.roster.generation + 1
        operators = [name for name, role in roles.items() if role is Role.OPERATOR]
        viewers = tuple(name for name, role in roles.items() if role is Role.VIEWER)
        permitted = [name for name, role in roles.items() if role is Role.PERMIT]
        return Roster(
            swarm=old.swarm,
            generation=generation,
            robots=tuple(name for name, role in roles.items() if role is Role.ROBOT),
            operators={
                name: old.operators.get(name) or public_bytes(self._key_of(name).public_key())
                for name in operators
            },
            viewers=viewers,
            secret_digest=digest_of(secret),
            readers={
                name: _reader_digest(generation, secret, name, is_operator=name in operators)
                for name in (*operators, *viewers, *permitted)
            },
            permits={
                name: replace(permits[name], key=public_bytes(self._key_of(name).public_key()))
                for name in permitted
            },
        )

    def issue(self, name: str, *, days: float | None = None, is_recorded: bool = True) -> Issued:
        """Make a new identity (certificate, private key, roster) for a name of the roster.

        `days`: the life of the certificate; None: the life that the authority's state names. The
        certificate of a name with a permit ends with the permit. With
        `is_recorded` the authority records the end of the certificate. False: the certificate may
        not reach the name, and the caller calls `note_issued` once it does. ConfigError if the
        roster lacks the name.
        """
        # 1. The certificate, for both ends of a TLS link.
        days = self._state.days if days is None else days
        role = self.roster.role_of(name)
        if role is None:
            raise ConfigError(f"{name} is not on the roster of {self.roster.swarm}")
        with self._locked():  # makes the private key of a new name, which all processes then use
            key = self._key_of(name)
        until = _now() + datetime.timedelta(days=days)
        permit = self.roster.permits.get(name)
        if permit is not None:
            until = datetime.datetime.fromtimestamp(permit.until, datetime.UTC)
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        certificate = (
            _builder(subject, self._certificate.subject, key.public_key(), until)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
            .add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False)
            .sign(self._key, hashes.SHA256())
        )

        # 2. The identity. Its private key is not encrypted: a daemon cannot ask for a passphrase.
        issued = Issued(
            info=IdentityInfo(
                swarm=self.roster.swarm,
                name=name,
                role=role,
                expires=int(until.timestamp()),
                authority=self.public_key,
            ),
            certificate=certificate.public_bytes(serialization.Encoding.PEM),
            key=pem_of(key, None),
            authority=self._certificate.public_bytes(serialization.Encoding.PEM),
            roster=RosterFile(self.signed_roster, self.keys_of(name)),
        )
        if is_recorded:
            self.note_issued(issued)
        return issued

    def note_issued(self, issued: Issued) -> None:
        """Record that a name has, or will get, this certificate.

        ConfigError if the name was revoked after the certificate was issued.
        """
        name = issued.info.name
        with self._locked():
            state, roster = self._read_state()
            if roster.role_of(name) is None:
                raise ConfigError(f"{name} was revoked just now by another command")
            old = state.issued.get(name)
            # A bundle may not be installed yet: the recorded generation stays as it is.
            generation = self.roster.generation if old is None else old.generation
            self._note(state, {name: IssueRecord(issued.info.expires, generation)})

    def record_of(self, name: str) -> IssueRecord | None:
        """The record of the newest certificate of a name; None without a certificate."""
        return self._state.issued.get(name)

    def note_taken(self, names: Iterable[str]) -> None:
        """Record that these names have the generation of `roster`."""
        own = self.roster.generation
        with self._locked():
            state, _ = self._read_state()
            present = {name: state.issued[name] for name in names if name in state.issued}
            records = {
                name: IssueRecord(record.expires, max(record.generation, own))
                for name, record in present.items()
            }
            self._note(state, records)

    def roster_of(self, name: str, generation: int) -> RosterFile | None:
        """Roster and keys of a name at an earlier generation; None if these are dropped by now."""
        for state in (self._state.now, *reversed(self._state.past)):
            roster = read_roster(state.roster, self.public_key)
            if roster.generation == generation:
                return RosterFile(state.roster, self._keys(name, roster, state.secret))
        return None

    def keys_of(self, name: str) -> datagram_keys.DatagramKeys:
        """The datagram keys for a name of the roster."""
        return self._keys(name, self.roster, self.secret)

    def _keys(self, name: str, roster: Roster, swarm_secret: bytes) -> datagram_keys.DatagramKeys:
        master = self._state.master
        if name in roster.robots:
            secret = datagram_keys.robot_secret(master, name)
            return datagram_keys.robot_keys(roster.generation, swarm_secret, secret)
        answers = {
            robot: datagram_keys.derive(datagram_keys.robot_secret(master, robot), f"answer/{name}")
            for robot in roster.robots
        }
        return datagram_keys.reader_keys(
            roster.generation,
            swarm_secret,
            name,
            is_operator=name in roster.operators,
            answers=answers,
        )

    @property
    def days(self) -> float:
        """The life of new certificates."""
        return self._state.days

    @property
    def secret(self) -> bytes:
        """The secret of the swarm at this generation."""
        return self._state.now.secret

    @property
    def signed_roster(self) -> bytes:
        """The roster of this generation with its signature."""
        return self._state.now.roster

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Lock the authority in the block against changes by other processes.

        A home on NFS may have no locks of files; its folder then locks out the processes of this
        machine. ConfigError if neither can be locked: two changes at once would lose one.
        """
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC
        folder_flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
        with ExitStack() as opened:
            for path, how in ((self.folder / LOCK, flags), (self.folder, folder_flags)):
                try:
                    handle = os.open(path, how, 0o600)
                    opened.callback(os.close, handle)
                    is_locked = lock_file(handle, waits=True)
                except OSError as error:
                    raise ConfigError(f"authority {path}: {error.strerror}") from error
                if is_locked:
                    break
            else:
                raise ConfigError(
                    f"authority {self.folder}: its file system has no locks, and two changes at"
                    " once would lose one; move the folder of your settings to a local disk and"
                    " name it by XDG_CONFIG_HOME"
                )
            yield

    def _read_state(self) -> tuple[AuthorityState, Roster]:
        """The present state on disk and its roster. ConfigError if it cannot be read."""
        path = self.folder / STATE
        try:
            state = msgspec.msgpack.decode(read_regular(path), type=AuthorityState)
            return state, read_roster(state.now.roster, self.public_key)
        except OSError as error:
            raise ConfigError(f"authority {path.parent}: {error.strerror}: {path}") from error
        except (ValueError, CodecError) as error:
            raise ConfigError(f"authority {path.parent}: {error}") from error

    def _store(self, state: AuthorityState) -> None:
        write_private(self.folder / STATE, msgspec.msgpack.encode(state))
        self._state = state

    def _note(self, newest: AuthorityState, records: Mapping[str, IssueRecord]) -> None:
        """Add records to the newest state on disk; `roster` of this process stays the same."""
        issued = {**newest.issued, **records}
        if issued != newest.issued:
            write_private(
                self.folder / STATE, msgspec.msgpack.encode(replace(newest, issued=issued))
            )
        self._state = replace(self._state, issued=issued)

    def _remove_keys(self, names: Iterable[str]) -> None:
        for name in names:
            with suppress(FileNotFoundError):
                self._key_path(name).unlink()

    def _key_path(self, name: str) -> Path:
        return self.folder / NAMES / f"{name}.key"

    def _key_of(self, name: str) -> ec.EllipticCurvePrivateKey:
        """The private key of a name; made and stored at the first call."""
        path = self._key_path(name)
        if path.exists():
            return load_key(path, self._passphrase)
        key = ec.generate_private_key(ec.SECP256R1())
        path.parent.mkdir(exist_ok=True, mode=0o700)
        write_private(path, pem_of(key, self._passphrase))
        return key


def is_encrypted(folder: Path) -> bool:
    """True if the authority in `folder` needs its passphrase. ConfigError without an authority."""
    try:
        return b"ENCRYPTED" in read_regular(folder / KEY)
    except OSError as error:
        raise ConfigError(f"no authority in {folder}: {error.strerror}") from error


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, until: datetime.datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(_BEGIN)
        .not_valid_after(until)
    )


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)


def _reader_digest(generation: int, secret: bytes, name: str, *, is_operator: bool) -> bytes:
    """The digest of the datagram keys of a name that is no robot, at a generation of the roster.

    `answers`, the keys that a reader shares with robots, are no part of the digest: they do not
    change with the roster.
    """
    keys = datagram_keys.reader_keys(generation, secret, name, is_operator=is_operator, answers={})
    return datagram_keys.reader_digest(keys)
