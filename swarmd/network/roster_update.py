"""An operator or viewer whose roster is older than that of the robots takes theirs.

Robots do not answer what is signed with keys of an earlier generation, so that nothing else works
before that.
"""

from __future__ import annotations

import asyncio

from swarmd.core.errors import CodecError, ConfigError, NetworkError
from swarmd.network.datagram import Address
from swarmd.network.pull import pull
from swarmd.network.settings import NetworkSettings
from swarmd.security.identity import Identity
from swarmd.security.roster_change import read_shared, take_roster

PULL_TIMEOUT = 5.0  # s


def pulled_roster(
    settings: NetworkSettings, identity: Identity, robot: str, address: Address, generation: int
) -> tuple[Identity | None, str]:
    """The identity with the roster that a robot hands over, and a line for the user.

    The identity's folder gets it, too. None if the roster cannot be had. Raises NetworkError in one
    line if this name is no longer on it.
    """
    pulling = pull(
        settings,
        robot,
        address,
        "roster",
        identity.name,
        identity=identity,
        timeout=PULL_TIMEOUT,
    )
    try:
        taken = take_roster(identity, read_shared(asyncio.run(pulling)))
    except (NetworkError, TimeoutError, CodecError, ConfigError, OSError) as error:
        return None, (
            f"{robot} shows generation {generation} of the roster, {identity.name} has"
            f" {identity.roster.generation}, and the newer one cannot be had"
            f" ({str(error) or 'no answer'}); {identity.name} was revoked, or needs a new bundle"
        )
    if taken.is_revoked:
        raise NetworkError(f"{identity.name} is no longer on the roster of {settings.swarm}")
    return (
        taken.identity,
        f"took {taken.text} from {robot}",
    )
