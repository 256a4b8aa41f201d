"""Pulls a newer roster, or missing keys, for an operator or viewer from robots.

Robots do not answer datagrams signed with keys of an earlier generation of the roster. So no
request works until the operator has the newer roster. An operator also lacks the key that it shares
with a robot that was added later, and pulls this key from the robot. The Zenoh link proves the name
of the robot, since the rules of `access.py` let a robot answer only on its own key expressions.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from contextlib import suppress

from swarmd.core.errors import CodecError, ConfigError, NetworkError
from swarmd.link.datagram import Address
from swarmd.link.keys.datagram_keys import KEY_BYTES
from swarmd.link.keys.identity import Identity
from swarmd.link.keys.roster_change import SharedRoster, read_shared, take_answers, take_roster
from swarmd.link.settings import NetworkSettings
from swarmd.link.spread.pull import pull

PULL_TIMEOUT = 5.0  # s
MAX_PULLS = 8  # pulls at a time
KEYS_TIMEOUT = 10.0  # s for the keys of all robots
_FAULTS = (NetworkError, TimeoutError, CodecError, ConfigError, OSError)


def pulled_roster(
    settings: NetworkSettings, identity: Identity, robot: str, address: Address, generation: int
) -> tuple[Identity | None, str]:
    """Pull the roster of a robot; returns the identity with this roster, and a line for the user.

    The roster is also written to the identity's folder. The returned identity is None if the roster
    cannot be pulled or verified. Raises NetworkError in one line if the roster lacks this name.
    """
    try:
        shared = asyncio.run(_pull_shared(settings, identity, robot, address))
        taken = take_roster(identity, shared, giver=robot)
    except _FAULTS as error:
        return None, (
            f"{robot} shows generation {generation} of the roster, {identity.name} has"
            f" {identity.roster.generation}, and the newer one cannot be had"
            f" ({str(error) or 'no answer'}); {identity.name} was revoked, or needs a new bundle"
        )
    if taken.is_revoked:
        raise NetworkError(f"{identity.name} is no longer on the roster of {settings.swarm}")
    return taken.identity, f"took {taken.text} from {robot}"


def pulled_keys(
    settings: NetworkSettings, identity: Identity, robots: Iterable[tuple[str, Address]]
) -> Identity | None:
    """Pull missing keys from robots; returns the identity with the keys that robots handed over.

    None if no robot handed over its key. Each robot has one key that it shares with this identity.
    `robots`: names, and the addresses from which datagrams with these names came. The datagrams may
    be forged. The link to an address proves whether the named robot answers there.
    """
    try:
        keys = asyncio.run(_pull_keys(settings, identity, robots))
    except OSError:  # no event loop, for example without a free file: the caller asks again
        return None
    return take_answers(identity, keys) if keys else None


async def _pull_shared(
    settings: NetworkSettings, identity: Identity, robot: str, address: Address
) -> SharedRoster:
    name = identity.name
    time = PULL_TIMEOUT
    blob = await pull(settings, robot, address, "roster", name, identity=identity, timeout=time)
    return read_shared(blob)


async def _pull_keys(
    settings: NetworkSettings, identity: Identity, robots: Iterable[tuple[str, Address]]
) -> dict[str, bytes]:
    keys: dict[str, bytes] = {}
    places = asyncio.Semaphore(MAX_PULLS)

    async def ask(robot: str, address: Address) -> None:
        async with places:
            if robot in keys:
                return
            try:
                shared = await _pull_shared(settings, identity, robot, address)
            except _FAULTS:
                return
        key = None if shared.keys is None else shared.keys.answers.get(robot)
        if key is not None and len(key) == KEY_BYTES:
            keys[robot] = key

    with suppress(TimeoutError):
        async with asyncio.timeout(KEYS_TIMEOUT), asyncio.TaskGroup() as group:
            for robot, address in robots:
                group.create_task(ask(robot, address))
    return keys
