"""swarmd: a runtime for robot swarms.

Public names are loaded when they are first used: a daemon imports none of them.
"""

from importlib import import_module
from typing import Any

_PUBLIC = {
    "env": "swarmd.sim.learning.environment",
}
"""Name -> its module."""


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'swarmd' has no attribute {name!r}")
    return getattr(import_module(_PUBLIC[name]), name)
