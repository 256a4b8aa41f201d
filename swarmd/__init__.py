"""swarmd: a runtime for robot swarms.

`import swarmd` imports none of its public names before they are used: the daemon and each verb of
swarmctl pass here.
"""

from typing import TYPE_CHECKING

# Each public name, and the module that has it.
_PUBLIC = {
    "env": "swarmd.sim.learning.environment",
}

if TYPE_CHECKING:  # the same names, for type checkers
    from swarmd.sim.learning.environment import env as env
else:

    def __getattr__(name: str) -> object:
        from importlib import import_module

        if name not in _PUBLIC:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_PUBLIC[name]), name)

    def __dir__() -> list[str]:
        return sorted({*globals(), *_PUBLIC})
