"""Key expressions: `swarm/<swarm>/<robot>/<plane>/<name>`, built and parsed only here.

A key of the planes `control`, `shared` and `message` has one more chunk at its end.

- `control`, `shared`: the last chunk is the asker. In a secured swarm this must be the name of the
  link's identity: a link drops any other asker (`link/access.py`).
- `message`: the last chunk is a channel of the pattern `<name>`. `<robot>` is the sender, a robot
  or a Zenoh program.

`swarm/<swarm>/<name>` is the liveliness token of a robot or program.

Ids are `[a-z0-9][a-z0-9_-]{0,62}`, so that no name can widen a key expression. A sample whose key
is not a concrete key of this form is dropped, since wildcard puts reach subscribers unchanged.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from swarmd.core.errors import ConfigError

ROOT = "swarm"
ANY = "*"
_ID = re.compile(r"[a-z0-9][a-z0-9_-]{0,62}")
ANYONE = "anyone"
"""The asker in an insecure swarm."""
STATE = "state"
CONTROL = "control"
SHARED = "shared"
MESSAGE = "message"
MULTICAST = "multicast"
UNICAST = "unicast"
"""The planes; `core/key_table.py` lists the names of each."""
_ASKED = frozenset({CONTROL, SHARED})
_SIX_CHUNKS = _ASKED | {MESSAGE}
_PLANES = frozenset({STATE, MULTICAST, UNICAST}) | _SIX_CHUNKS


class Key(NamedTuple):
    """A parsed key. `robot`: on plane `message` the sender, which may be a Zenoh program.

    `last`: the asker on the planes `control` and `shared`, the channel on `message`, else empty.
    """

    swarm: str
    robot: str
    plane: str
    name: str
    last: str = ""


def check_id(value: str, what: str) -> str:
    """Return a valid id unchanged; ConfigError, which names `what` ('robot id'), otherwise."""
    if _ID.fullmatch(value):
        return value
    raise ConfigError(
        f"{what} is {value!r}; expected 1 to 63 of a-z, 0-9, _ and -, the first a letter or digit"
    )


def is_id(value: str) -> bool:
    """True for a valid id."""
    return _ID.fullmatch(value) is not None


def build(swarm: str, robot: str, plane: str, name: str, last: str = "") -> str:
    """The key expression; `*` stands for every swarm, robot or name, or for the last chunk.

    `last`: on the planes `control`, `shared` and `message`, and only there.
    """
    if bool(last) != (plane in _SIX_CHUNKS):
        raise ValueError(f"a key of plane {plane} with last chunk {last!r}")
    return f"{ROOT}/{swarm}/{robot}/{plane}/{name}" + (f"/{last}" if last else "")


def token(swarm: str, name: str) -> str:
    """The key expression of the liveliness token of a robot or program; `*` stands for each."""
    return f"{ROOT}/{swarm}/{name}"


def named_by(key: str) -> str | None:
    """The robot or program of a liveliness token; None for a foreign or malformed token."""
    chunks = key.split("/")
    if len(chunks) != 3 or chunks[0] != ROOT or not all(map(is_id, chunks[1:])):
        return None
    return chunks[2]


def parse(key: str, *, is_query: bool = False) -> Key | None:
    """The parts of a concrete key; None for wildcards, foreign and malformed keys.

    The robot of a query may be `*`.
    """
    chunks = key.split("/")
    if len(chunks) not in (5, 6) or chunks[0] != ROOT or chunks[3] not in _PLANES:
        return None
    if (len(chunks) == 6) != (chunks[3] in _SIX_CHUNKS):
        return None
    is_for_all = is_query and chunks[2] == ANY
    names = (chunks[1], *(() if is_for_all else (chunks[2],)), *chunks[4:])
    if not all(is_id(name) for name in names):
        return None
    return Key(*chunks[1:])
