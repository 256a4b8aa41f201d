"""Key expressions: `swarm/<swarm>/<robot>/<plane>/<name>`, built and parsed only here.

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
_PLANES = frozenset({"state", "msg", "sense", "control", "multicast", "unicast", "hw"})


class Key(NamedTuple):
    """A parsed key. `name` follows the plane; for `msg` it is `<pattern>/<channel>`."""

    swarm: str
    robot: str
    plane: str
    name: str


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


def build(swarm: str, robot: str, plane: str, name: str) -> str:
    """The key expression; `*` stands for every swarm, robot or one chunk of the name."""
    return f"{ROOT}/{swarm}/{robot}/{plane}/{name}"


def parse(key: str) -> Key | None:
    """The parts of a concrete key; None for wildcards, foreign and malformed keys."""
    chunks = key.split("/")
    if len(chunks) not in (5, 6) or chunks[0] != ROOT or chunks[3] not in _PLANES:
        return None
    if (len(chunks) == 6) != (chunks[3] == "msg"):
        return None
    if not all(is_id(chunk) for chunk in (chunks[1], chunks[2], *chunks[4:])):
        return None
    return Key(chunks[1], chunks[2], chunks[3], "/".join(chunks[4:]))
