"""Key expressions: `swarm/<swarm>/<robot>/<plane>/<name>`, built and parsed only here.

What is asked of a robot, on the planes `control` and `shared`, has one more chunk: the asker. In a
secured swarm it is the name of an identity, and links let pass no other one (`network/access.py`).

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
STATE, CONTROL, SHARED, MULTICAST, UNICAST = "state", "control", "shared", "multicast", "unicast"
"""The planes; `core/key_table.py` lists the names of each."""
_ASKED = frozenset({CONTROL, SHARED})
_PLANES = frozenset({STATE, MULTICAST, UNICAST}) | _ASKED


class Key(NamedTuple):
    """A parsed key. `asker`: of the planes `control` and `shared`, else empty."""

    swarm: str
    robot: str
    plane: str
    name: str
    asker: str = ""


def check_id(value: str, what: str) -> str:
    """The id itself. Raises ConfigError naming `what`, such as 'robot id', if it is not valid."""
    if _ID.fullmatch(value):
        return value
    raise ConfigError(
        f"{what} is {value!r}; expected 1 to 63 of a-z, 0-9, _ and -, the first a letter or digit"
    )


def is_id(value: str) -> bool:
    """True for a valid id."""
    return _ID.fullmatch(value) is not None


def build(swarm: str, robot: str, plane: str, name: str, asker: str = "") -> str:
    """The key expression; `*` stands for every swarm, robot, asker or one chunk of the name.

    `asker`: on the planes `control` and `shared`, and only there.
    """
    if bool(asker) != (plane in _ASKED):
        raise ValueError(f"a key of plane {plane} with asker {asker!r}")
    return f"{ROOT}/{swarm}/{robot}/{plane}/{name}" + (f"/{asker}" if asker else "")


def parse(key: str, *, is_query: bool = False) -> Key | None:
    """The parts of a concrete key; None for wildcards, foreign and malformed keys.

    The robot of a query may be `*`.
    """
    chunks = key.split("/")
    if len(chunks) not in (5, 6) or chunks[0] != ROOT or chunks[3] not in _PLANES:
        return None
    if (len(chunks) == 6) != (chunks[3] in _ASKED):
        return None
    is_for_all = is_query and chunks[2] == ANY
    names = (chunks[1], *(() if is_for_all else (chunks[2],)), *chunks[4:])
    if not all(is_id(name) for name in names):
        return None
    return Key(*chunks[1:])
