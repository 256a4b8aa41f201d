"""Keys of a swarm in memory, as the authority derives them; without certificates and files."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping
from pathlib import Path

from swarmd.link.keys.datagram_keys import (
    DatagramKeys,
    derive,
    reader_keys,
    robot_keys,
    robot_secret,
)
from swarmd.link.keys.identity import Identity, IdentityInfo
from swarmd.link.keys.roster import KeyPermit, Roster
from swarmd.link.signature import Trust

AUTHORITY = b"k" * 64
_MASTER = b"m" * 32


class Keyring:
    """The names of a swarm at one generation of its roster, and what each of them holds."""

    def __init__(
        self,
        robots: Collection[str] = (),
        operators: Collection[str] = (),
        viewers: Collection[str] = (),
        permits: Mapping[str, KeyPermit] | None = None,
    ) -> None:
        self.secret = b""
        self.roster = Roster(
            swarm="lab",
            generation=1,
            robots=tuple(robots),
            operators=dict.fromkeys(operators, bytes(64)),
            viewers=tuple(viewers),
            secret_digest=bytes(32),
            permits=dict(permits or {}),
        )
        self.renew()

    def renew(self, add: Collection[str] = (), remove: Collection[str] = ()) -> None:
        """The next generation: without the names `remove`, and with the robots `add`."""
        old = self.roster
        generation = old.generation + 1
        self.secret = hashlib.sha256(generation.to_bytes(4, "big")).digest()
        self.roster = Roster(
            swarm=old.swarm,
            generation=generation,
            robots=tuple(name for name in (*old.robots, *add) if name not in remove),
            operators={name: key for name, key in old.operators.items() if name not in remove},
            viewers=tuple(name for name in old.viewers if name not in remove),
            secret_digest=hashlib.sha256(self.secret).digest(),
            permits={name: one for name, one in old.permits.items() if name not in remove},
        )

    def keys(self, name: str) -> DatagramKeys:
        """The keys of a name of the roster."""
        roster = self.roster
        if name in roster.robots:
            return robot_keys(roster.generation, self.secret, robot_secret(_MASTER, name))
        answers = {
            robot: derive(robot_secret(_MASTER, robot), f"answer/{name}") for robot in roster.robots
        }
        is_operator = name in roster.operators
        return reader_keys(
            roster.generation, self.secret, name, is_operator=is_operator, answers=answers
        )

    def identity(self, name: str) -> Identity:
        """The identity of a name of the roster, which has no files."""
        role = self.roster.role_of(name)
        assert role is not None
        info = IdentityInfo(
            swarm=self.roster.swarm, name=name, role=role, expires=2**40, authority=AUTHORITY
        )
        return Identity(Path("/nowhere"), info, self.roster, self.keys(name))

    def trust(self, name: str) -> Trust:
        """How a name signs and verifies."""
        return Trust.of(self.identity(name))
