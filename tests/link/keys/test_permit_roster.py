"""Rosters with permits: how the authority makes them, and what version 0.2.0 reads of them."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import msgspec
import pytest
from cryptography import x509
from msgspec import Meta, Struct
from msgspec.structs import replace

from swarmd.core.bounds import Id
from swarmd.core.errors import CodecError, ConfigError
from swarmd.link.keys.content_signature import Purpose, sign
from swarmd.link.keys.private_keys import load_key, public_bytes
from swarmd.link.keys.roster import (
    KeyPermit,
    Role,
    SignedRoster,
    encode_roster,
    pack_roster,
    read_roster,
)
from swarmd.link.keys.roster_change import share_roster
from tests.support.keys import SwarmKeys

UNTIL = int(time.time()) + 600
AGENT = KeyPermit(role="agents", key=bytes(64), may=("stop",), until=UNTIL)


class Roster020(Struct, frozen=True, kw_only=True):
    """`Roster` of version 0.2.0, copied from its `link/keys/roster.py`."""

    swarm: Id
    generation: Annotated[int, Meta(ge=1, le=2**32 - 1)]
    robots: Annotated[tuple[Id, ...], Meta(max_length=2048)] = ()
    operators: Annotated[
        dict[Id, Annotated[bytes, Meta(min_length=64, max_length=64)]], Meta(max_length=2048)
    ] = {}
    viewers: Annotated[tuple[Id, ...], Meta(max_length=2048)] = ()
    secret_digest: Annotated[bytes, Meta(min_length=32, max_length=32)]
    readers: Annotated[
        dict[Id, Annotated[bytes, Meta(min_length=32, max_length=32)]], Meta(max_length=4096)
    ] = {}

    def role_of(self, name: str) -> str | None:
        if name in self.robots:
            return "robot"
        if name in self.operators:
            return "operator"
        return "viewer" if name in self.viewers else None


@pytest.fixture
def keys(tmp_path: Path) -> SwarmKeys:
    return SwarmKeys(tmp_path, "lab", ("r1", "r2"), operators=("alice",), viewers=("class",))


def test_version_0_2_0_takes_a_roster_with_permits_and_does_not_know_their_names(
    keys: SwarmKeys,
) -> None:
    keys.authority.change(permits={"agent": AGENT}, remove=["r2", "class"])
    signed = msgspec.msgpack.decode(keys.authority.signed_roster, type=SignedRoster)
    old = msgspec.msgpack.decode(signed.content, type=Roster020)
    assert (old.generation, old.robots, [*old.operators]) == (3, ("r1",), ["alice"])
    roles = {name: old.role_of(name) for name in ("r1", "r2", "class", "alice", "agent")}
    assert roles == {"r1": "robot", "r2": None, "class": None, "alice": "operator", "agent": None}


def test_the_roster_has_the_key_of_a_permit_and_its_certificate_ends_with_it(
    keys: SwarmKeys,
) -> None:
    roster = keys.authority.change(permits={"agent": AGENT})
    assert roster.role_of("agent") is Role.PERMIT
    issued = keys.authority.issue("agent", days=90.0)
    assert (issued.info.role, issued.info.expires) == (Role.PERMIT, UNTIL)
    certificate = x509.load_pem_x509_certificate(issued.certificate)
    assert int(certificate.not_valid_after_utc.timestamp()) == UNTIL
    private = load_key(keys.authority.folder / "names" / "agent.key", None)
    assert roster.permits["agent"].key == public_bytes(private.public_key())


def test_a_permit_is_replaced_and_outlives_other_changes(keys: SwarmKeys) -> None:
    first = keys.authority.change(permits={"agent": AGENT})
    wider = replace(AGENT, may=("stop", "run dispersion"))
    keys.authority.change(permits={"agent": wider})
    roster = keys.authority.change(add={"r3": Role.ROBOT}, remove=["class"])
    assert roster.permits["agent"].may == ("stop", "run dispersion")
    assert roster.permits["agent"].key == first.permits["agent"].key
    gone = keys.authority.change(remove=["agent"])
    assert gone.permits == {}


@pytest.mark.parametrize("name", ["alice", "class", "r1"])
def test_a_name_with_another_role_gets_no_permit(keys: SwarmKeys, name: str) -> None:
    with pytest.raises(ConfigError):
        keys.authority.change(permits={name: AGENT})


@pytest.mark.parametrize("name", ["alice", "class", "r1"])
def test_a_roster_with_a_permit_for_a_name_of_another_role_is_refused(
    keys: SwarmKeys, name: str
) -> None:
    """Robots of 0.2.0 would take the name for its other role."""
    key = load_key(keys.authority.folder / "authority.key", None)
    twice = replace(keys.authority.roster, permits={name: AGENT})
    content = encode_roster(twice)
    packed = pack_roster(content, sign(key, Purpose.ROSTER, content))
    with pytest.raises(CodecError, match=name):
        read_roster(packed, keys.authority.public_key)


def test_a_name_with_a_permit_gets_no_secret_of_the_swarm_from_a_robot(keys: SwarmKeys) -> None:
    keys.authority.change(permits={"agent": AGENT})
    keys.authority.issue("r1").write(keys.folder_of("r1"))
    shared = share_roster(keys["r1"], "agent")
    assert shared is not None
    assert keys.authority.secret not in shared
    assert keys["r1"].datagram_keys.operators not in shared
    assert keys["r1"].datagram_keys.viewers in shared
