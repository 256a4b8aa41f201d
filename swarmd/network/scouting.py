"""The swarms within reach, for an operator who finds no member of the swarm that was named.

A swarm meets on one of 64 multicast ports, chosen by its name. All are scouted at once; each peer
that answers is dialled, and its tokens contain the names.
"""

from __future__ import annotations

import json
import time
from contextlib import suppress

import zenoh

from swarmd.core.errors import NetworkError
from swarmd.core.keys import ANY, build, parse
from swarmd.network.session import (
    FIRST_PORT,
    MULTICAST_ADDRESS,
    PORTS,
    open_with,
    session_options,
    undeclare,
)
from swarmd.network.settings import NetworkSettings

_TOKENS = build(ANY, ANY, "alive", ANY)


def swarms_in_reach(
    session: zenoh.Session, settings: NetworkSettings, timeout: float
) -> tuple[str, ...]:
    """Names of swarms with a living daemon, sorted; takes up to three times `timeout` s."""
    if not settings.multicast:
        return tuple(sorted(_names(session, timeout)))
    found = _names(session, timeout)
    locators = _scout(settings.interface_name, timeout)
    if locators:
        options = session_options(settings) | {
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "connect/endpoints": sorted(locators),
            "open/return_conditions/connect_scouted": True,
        }
        with suppress(NetworkError), open_with(options, what="a look around") as visitor:
            found |= _names(visitor, timeout)
    return tuple(sorted(found))


def _names(session: zenoh.Session, timeout: float) -> set[str]:
    """The swarms of the tokens that the session sees within `timeout` s.

    By a subscriber: `liveliness().get` of Zenoh 1.10 was seen twice not to return, whatever its
    timeout, on a session whose links were coming up.
    """
    found: set[str] = set()

    def on_token(sample: zenoh.Sample) -> None:
        key = parse(str(sample.key_expr))
        if key is not None and sample.kind == zenoh.SampleKind.PUT:
            found.add(key.swarm)

    tokens = session.liveliness().declare_subscriber(_TOKENS, on_token, history=True)
    time.sleep(timeout)
    undeclare(tokens)
    return set(found)


def _scout(interface: str, timeout: float) -> set[str]:
    scouts = []
    for port in range(FIRST_PORT, FIRST_PORT + PORTS):
        config = zenoh.Config()
        config.insert_json5("scouting/multicast/interface", json.dumps(interface))
        config.insert_json5("scouting/multicast/address", json.dumps(f"{MULTICAST_ADDRESS}:{port}"))
        scouts.append(zenoh.scout(what="peer", config=config))
    time.sleep(timeout)
    locators: set[str] = set()
    for scout in scouts:
        with suppress(zenoh.ZError):  # one that could not begin, as without multicast
            while hello := scout.try_recv():
                locators.update(hello.locators)
        scout.stop()
    return locators
