"""swarmd: a runtime for robot swarms.

A public name is imported when it is first used: the daemon and each verb of swarmctl run
`import swarmd`, which must not load the client and the simulation. From the first import on,
`import` of a kernel gives the compiled one (core/kernels.py).
"""

from typing import TYPE_CHECKING

from swarmd.core.former_names import install_former_names
from swarmd.core.kernels import install_finder

install_finder()
install_former_names()

# Each public name, and the module that has it.
_PUBLIC = {
    "connect": "swarmd.operator.client.connect",
    "demo": "swarmd.sim.live.simulated_swarm",
    "env": "swarmd.sim.learning.environment",
    "load_results": "swarmd.sim.experiments.results",
    "simulate": "swarmd.sim.experiments.simulate",
}

if TYPE_CHECKING:  # the same names, for type checkers
    from swarmd.operator.client.connect import connect as connect
    from swarmd.sim.experiments.results import load_results as load_results
    from swarmd.sim.experiments.simulate import simulate as simulate
    from swarmd.sim.learning.environment import env as env
    from swarmd.sim.live.simulated_swarm import demo as demo
else:

    def __getattr__(name: str) -> object:
        from importlib import import_module  # `import swarmd` loads nothing

        if name not in _PUBLIC:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_PUBLIC[name]), name)

    def __dir__() -> list[str]:
        return sorted({*globals(), *_PUBLIC})
