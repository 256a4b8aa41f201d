"""Takes a roster, or a renewed certificate, into an installed identity.

The authority's signature alone makes a roster or certificate valid, so that any robot or operator
may hand them over. A roster of a smaller generation never replaces a roster of a greater
generation. With a roster come the keys of datagrams. One of these keys has no digest on the roster:
the *pair key*, which an operator or viewer shares with one robot. A pair key is taken only from a
bundle, which the authority made, or from the robot that shares the key.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.codec import decode
from swarmd.core.errors import CodecError, ConfigError
from swarmd.link.keys.certificate_check import check_certificate
from swarmd.link.keys.datagram_keys import (
    KEY_BYTES,
    DatagramKeys,
    Secret,
    reader_digest,
    reader_keys,
    robot_keys,
)
from swarmd.link.keys.identity import (
    CERTIFICATE,
    INFO,
    Identity,
    RosterFile,
    load_identity,
    write_private,
    write_roster,
)
from swarmd.link.keys.roster import MAX_ROSTER, Role, Roster, digest_of, read_roster, same_bytes


class SharedRoster(Struct, frozen=True, array_like=True):
    """A signed roster for transfer, with the swarm's secret (to a robot) or keys (to a reader).

    A reader is an operator or viewer.
    """

    roster: bytes
    secret: Secret = b""
    keys: DatagramKeys | None = None


@dataclass(frozen=True, slots=True)
class TakenRoster:
    """An identity after it took a roster."""

    identity: Identity
    is_changed: bool  # the roster is newer than before, or the certificate was renewed
    text: str  # the change in words
    fault: str = ""  # why the roster could not be written to disk, so that a restart forgets it

    @property
    def is_revoked(self) -> bool:
        """True if the roster lacks this name, or has it in another role."""
        return is_revoked(self.identity)


_shared = msgspec.msgpack.Decoder(SharedRoster)


def is_revoked(identity: Identity) -> bool:
    """True if the identity's roster lacks its name, or has the name in another role."""
    return identity.roster.role_of(identity.name) is not identity.role


def take_roster(
    identity: Identity, shared: SharedRoster, certificate: bytes = b"", *, giver: str = ""
) -> TakenRoster:
    """Check a roster and a renewed certificate, and write them into the identity's folder.

    - `certificate`: PEM; empty: the present certificate stays.
    - `giver`: the robot that handed the roster over, as its link has proved; empty: no robot. Of
      the pair keys in `shared`, an operator or viewer takes only the key shared with `giver`.

    If the disk cannot be written, the returned identity has the roster all the same, and
    `TakenRoster.fault` says why. CodecError if the authority has not signed the roster, or the
    roster is of another swarm, or older. ConfigError if the certificate does not match. Takes about
    20 ms and writes to disk.
    """
    # 1. Check the roster.
    roster, signed = _checked_roster(identity, shared)
    is_newer = roster.generation > identity.roster.generation
    keys = _keys_of(identity, roster, shared, giver) if is_newer else identity.datagram_keys
    taken = replace(identity, roster=roster, datagram_keys=keys, signed_roster=signed)
    changes = [f"generation {roster.generation} of the roster"]  # for the user
    fault = ""

    # 2. Take the certificate, unless it ends before the present certificate.
    renewed: Identity | None = None
    if certificate and certificate != identity.certificate.read_bytes():
        try:
            renewed = take_certificate(identity, certificate)
            if renewed is None:
                changes.append("its certificate ends later than the certificate that was sent")
        except OSError as error:
            fault = f"the new certificate cannot be written: {error.strerror}"
    if renewed is not None:
        taken = replace(taken, info=renewed.info)

    # 3. Write the roster, unless another process of this identity has written it already.
    try:
        if load_identity(identity.folder).signed_roster != signed:
            write_roster(identity.folder, RosterFile(signed, keys))
    except OSError as error:
        fault = f"in memory only: {error.strerror}"  # in place of a fault of the certificate
    if is_revoked(taken):
        changes.append(f"{identity.name} is no longer on it")
    if renewed is not None:
        changes.append("a new certificate")
    if fault:
        changes.append(fault)
    is_changed = is_newer or renewed is not None
    return TakenRoster(taken, is_changed, ", ".join(changes), fault)


def read_shared(data: bytes) -> SharedRoster:
    """Decode a roster that a peer handed over. CodecError if malformed."""
    if len(data) > 2 * MAX_ROSTER:
        raise CodecError(f"a shared roster of {len(data)} bytes")
    return decode(_shared, data, "a shared roster")


def share_roster(identity: Identity, asker: str) -> bytes | None:
    """The encoded `SharedRoster` that the robot `identity` hands to `asker`.

    `asker`: the name that the asker's link has proved. An asker that is a robot gets roster and
    secret of the swarm. An operator or viewer gets the roster, the asker's datagram keys, and the
    key that the asker shares with this robot. None if the roster lacks the asker, or this robot.
    """
    keys = identity.datagram_keys
    role = identity.roster.role_of(asker)
    if role is None or is_revoked(identity):
        return None
    if role is Role.ROBOT:
        shared = SharedRoster(identity.signed_roster, keys.secret)
    else:
        asker_keys = reader_keys(
            keys.generation,
            keys.secret,
            asker,
            is_operator=role is Role.OPERATOR,
            answers={identity.name: keys.answer_to(asker)},
        )
        shared = SharedRoster(identity.signed_roster, keys=asker_keys)
    return msgspec.msgpack.encode(shared)


def take_answers(identity: Identity, answers: Mapping[str, bytes]) -> Identity:
    """Add pair keys to the identity of an operator or viewer, and write them to disk.

    `answers`: by robot, the pair key that this robot sent. Keys that cannot be written are in the
    returned identity all the same, and are pulled again after a restart.
    """
    keys = _with_answers(identity.datagram_keys, identity.roster, answers)
    try:
        stored = load_identity(identity.folder)  # another process may have written new keys
        if stored.signed_roster == identity.signed_roster:
            whole = _with_answers(stored.datagram_keys, stored.roster, answers)
            write_roster(identity.folder, RosterFile(stored.signed_roster, whole))
    except (OSError, ConfigError):
        pass
    return replace(identity, datagram_keys=keys)


def _with_answers(keys: DatagramKeys, roster: Roster, answers: Mapping[str, bytes]) -> DatagramKeys:
    """`keys` with the pair keys `answers` of the robots that are on the roster."""
    known = {**keys.answers, **answers}
    kept = {n: key for n, key in known.items() if n in roster.robots and len(key) == KEY_BYTES}
    return replace(keys, answers=kept)


def _checked_roster(identity: Identity, shared: SharedRoster) -> tuple[Roster, bytes]:
    """The roster of `shared`, and its signed bytes; CodecError if it cannot replace the present.

    If only encoding or signature differ from the present roster, the bytes are the present bytes.
    """
    roster = read_roster(shared.roster, identity.info.authority)
    signed = same_bytes(shared.roster, identity.signed_roster)
    if roster.swarm != identity.info.swarm:
        raise CodecError(f"a roster of swarm {roster.swarm}, not of {identity.info.swarm}")
    present = identity.roster.generation
    if roster.generation < present:
        raise CodecError(f"a roster of generation {roster.generation}; it has generation {present}")
    if roster.generation == present and signed != identity.signed_roster:
        raise CodecError(f"another roster of generation {present}: its authority was an older copy")
    return roster, signed


def _keys_of(identity: Identity, roster: Roster, shared: SharedRoster, giver: str) -> DatagramKeys:
    """The keys with which this identity signs and checks datagrams, for the generation of `roster`.

    A robot derives its keys from the secret of the swarm in `shared`. An operator or viewer (a
    *reader*) takes its keys from `shared`. `giver`: the robot that sent `shared`, as its link has
    proved; empty: no robot. All keys are empty if the roster lacks this identity's name, or has the
    name in another role. CodecError if the secret or the keys do not have the digest on the roster.
    """
    role = roster.role_of(identity.name)
    present = identity.datagram_keys
    if role is not identity.role:
        return DatagramKeys(generation=roster.generation)
    if role is Role.ROBOT:
        if digest_of(shared.secret) != roster.secret_digest:
            raise CodecError("a roster with a secret that does not belong to it")
        # The robot's own secret for answers does not change with the roster.
        return robot_keys(roster.generation, shared.secret, present.answer_secret)
    # An operator or viewer: the keys come from a robot, and are checked by the roster's digest.
    keys = shared.keys
    if keys is None or reader_digest(keys) != roster.readers.get(identity.name):
        raise CodecError("a roster without the keys that belong to it")
    new_keys = DatagramKeys(
        generation=roster.generation,
        operators=keys.operators,
        viewers=keys.viewers,
        own=keys.own,
        answers=present.answers,  # pair keys, which do not change with the roster
    )
    # The roster has no digest of pair keys: only the robot that proved its name gives its key.
    pair_key = {robot: key for robot, key in keys.answers.items() if robot == giver}
    return _with_answers(new_keys, roster, pair_key)


def take_certificate(identity: Identity, certificate: bytes) -> Identity | None:
    """Check a certificate (PEM) against key and authority, and replace the identity's certificate.

    Returns the identity with the new certificate. Changes nothing and returns None if the
    certificate ends before the present certificate: an old certificate that is sent again would end
    the links of a robot early. ConfigError if the certificate does not match.
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
    info = replace(identity.info, expires=facts.expires)
    write_private(identity.folder / INFO, msgspec.json.encode(info))
    return load_identity(identity.folder)
