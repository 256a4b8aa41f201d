"""Taking a roster, and a renewed certificate, into an identity that is there already.

What an identity takes is checked against its authority alone; the sender does not matter. A
smaller generation never replaces a greater one. The key of an operator or viewer with a robot is
not on the roster: it is taken from the authority, in a bundle, or from that robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import msgspec
from msgspec import Struct

from swarmd.core.codec import decode
from swarmd.core.errors import CodecError, ConfigError
from swarmd.security.certificate_check import check_certificate
from swarmd.security.datagram_keys import (
    KEY_BYTES,
    DatagramKeys,
    Secret,
    reader_digest,
    reader_keys,
    robot_keys,
)
from swarmd.security.identity import (
    CERTIFICATE,
    INFO,
    Identity,
    RosterFile,
    load_identity,
    write_private,
    write_roster,
)
from swarmd.security.roster import MAX_ROSTER, Role, Roster, digest_of, read_roster, same_bytes


class SharedRoster(Struct, frozen=True, array_like=True):
    """A signed roster on its way: with the secret for a robot, with its keys for a reader."""

    roster: bytes
    secret: Secret = b""
    keys: DatagramKeys | None = None


@dataclass(frozen=True, slots=True)
class TakenRoster:
    """An identity after it took a roster."""

    identity: Identity
    is_changed: bool  # False if the identity had this roster
    text: str  # the change in words
    fault: str = ""  # why the roster is not on the disk: a restart then forgets it

    @property
    def is_revoked(self) -> bool:
        """True if the roster does not have this name in its role."""
        return is_revoked(self.identity)


_shared = msgspec.msgpack.Decoder(SharedRoster)


def is_revoked(identity: Identity) -> bool:
    """True if the identity's own roster does not have its name in its role."""
    return identity.roster.role_of(identity.name) is not identity.role


def take_roster(
    identity: Identity, shared: SharedRoster, certificate: bytes = b"", *, giver: str = ""
) -> TakenRoster:
    """Check a roster and a certificate, and write them into the identity's folder.

    `giver`: the robot that handed it over, as its link has proved: an operator or viewer takes the
    key with that robot, and with no other one. A disk that cannot be written keeps no robot from
    what its authority decided; see `TakenRoster`. CodecError if the roster is not signed by the
    authority or does not fit; ConfigError if the certificate does not. It takes about 20 ms and
    writes to the disk.
    """
    roster = read_roster(shared.roster, identity.info.authority)
    signed = same_bytes(shared.roster, identity.signed_roster)
    if roster.swarm != identity.info.swarm:
        raise CodecError(f"a roster of swarm {roster.swarm}, not of {identity.info.swarm}")
    own = identity.roster.generation
    if roster.generation < own:
        raise CodecError(f"a roster of generation {roster.generation}; it has generation {own}")
    if roster.generation == own and signed != identity.signed_roster:
        raise CodecError(f"another roster of generation {own}: its authority was an older copy")
    is_newer = roster.generation > own
    keys = _keys_of(identity, roster, shared, giver) if is_newer else identity.datagram_keys
    words = [f"generation {roster.generation} of the roster"]
    fault = ""
    is_renewed = False
    taken = replace(identity, roster=roster, datagram_keys=keys, signed_roster=signed)
    if certificate and certificate != identity.certificate.read_bytes():
        try:
            renewed = take_certificate(identity, certificate)
            if renewed is None:
                words.append("its certificate ends later than the certificate that was sent")
            else:
                taken, is_renewed = replace(taken, info=renewed.info), True
        except OSError as error:
            fault = f"the new certificate cannot be written: {error.strerror}"
    try:
        if load_identity(identity.folder).signed_roster != signed:
            write_roster(identity.folder, RosterFile(signed, keys))
    except OSError as error:
        fault = f"in memory only: {error.strerror}"
    if is_revoked(taken):
        words.append(f"{identity.name} is no longer on it")
    if is_renewed:
        words.append("a new certificate")
    if fault:
        words.append(fault)
    return TakenRoster(taken, is_renewed or is_newer, ", ".join(words), fault)


def read_shared(data: bytes) -> SharedRoster:
    """What a peer shared. CodecError if it cannot be read."""
    if len(data) > 2 * MAX_ROSTER:
        raise CodecError(f"a shared roster of {len(data)} bytes")
    return decode(_shared, data, "a shared roster")


def share_roster(identity: Identity, asker: str) -> bytes | None:
    """What the robot `identity` hands to `asker`, whose name its link has proved; None: nothing.

    A robot gets the swarm's secret; an operator or viewer its own keys, of which this robot can
    make those with itself only.
    """
    keys, role = identity.datagram_keys, identity.roster.role_of(asker)
    if role is None or is_revoked(identity):
        return None
    if role is Role.ROBOT:
        shared = SharedRoster(identity.signed_roster, keys.secret)
    else:
        own = reader_keys(
            keys.generation,
            keys.secret,
            asker,
            is_operator=role is Role.OPERATOR,
            answers={identity.name: keys.answer_to(asker)},
        )
        shared = SharedRoster(identity.signed_roster, keys=own)
    return msgspec.msgpack.encode(shared)


def take_answers(identity: Identity, answers: Mapping[str, bytes]) -> Identity:
    """The identity with these keys with robots, each of which handed over its own; writes them.

    A disk that cannot be written forgets them, and they are asked for again.
    """
    keys = _with_answers(identity.datagram_keys, identity.roster, answers)
    try:
        stored = load_identity(identity.folder)  # another process may have written meanwhile
        if stored.signed_roster == identity.signed_roster:
            whole = _with_answers(stored.datagram_keys, stored.roster, answers)
            write_roster(identity.folder, RosterFile(stored.signed_roster, whole))
    except (OSError, ConfigError):
        pass
    return replace(identity, datagram_keys=keys)


def _with_answers(keys: DatagramKeys, roster: Roster, answers: Mapping[str, bytes]) -> DatagramKeys:
    """The keys with those with robots, without robots that are not on the roster."""
    known = {**keys.answers, **answers}
    kept = {n: key for n, key in known.items() if n in roster.robots and len(key) == KEY_BYTES}
    return msgspec.structs.replace(keys, answers=kept)


def _keys_of(identity: Identity, roster: Roster, shared: SharedRoster, giver: str) -> DatagramKeys:
    """The keys of the identity at the generation of `roster`; none for a name not on `roster`."""
    role, old = roster.role_of(identity.name), identity.datagram_keys
    if role is not identity.role:
        return DatagramKeys(generation=roster.generation)
    if role is Role.ROBOT:
        if digest_of(shared.secret) != roster.secret_digest:
            raise CodecError("a roster with a secret that does not belong to it")
        return robot_keys(roster.generation, shared.secret, old.answer_secret)
    keys = shared.keys
    if keys is None or reader_digest(keys) != roster.readers.get(identity.name):
        raise CodecError("a roster without the keys that belong to it")
    own = DatagramKeys(
        generation=roster.generation,
        operators=keys.operators,
        viewers=keys.viewers,
        own=keys.own,
        answers=old.answers,
    )
    return _with_answers(own, roster, {n: key for n, key in keys.answers.items() if n == giver})


def take_certificate(identity: Identity, certificate: bytes) -> Identity | None:
    """Replace the certificate of an identity, once it is checked against key and authority.

    None if the certificate ends before the present certificate, which is kept: an old certificate,
    sent again, would end the links of a robot early. ConfigError if the certificate does not fit.
    """
    draft = identity.folder / f".{CERTIFICATE}.new"
    try:
        write_private(draft, certificate)
        facts = check_certificate(draft, identity.key, identity.authority)
    finally:
        draft.unlink(missing_ok=True)
    if facts.name != identity.name:
        raise ConfigError(f"a certificate of {facts.name}, not of {identity.name}")
    if facts.expires < identity.info.expires:
        return None
    write_private(identity.certificate, certificate)
    info = msgspec.structs.replace(identity.info, expires=facts.expires)
    write_private(identity.folder / INFO, msgspec.json.encode(info))
    return load_identity(identity.folder)
