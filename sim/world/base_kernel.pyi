from swarmd.core.values import Array
from swarmd.sim.world.base_dynamics import Actuators, BaseDynamics
from swarmd.sim.world.geometry import Indices

class Servos:
    def __init__(
        self,
        actuators: Actuators,
        drives: BaseDynamics,
        dt: float,
        memory: tuple[Array, Array, Array],
        before: tuple[Array, Array],
    ) -> None: ...
    def put(self, commands: Array) -> None: ...
    def drive(self) -> None: ...

class Wheels:
    def __init__(self, measured: Array, truth: Array, reported: Array) -> None: ...
    def read(
        self,
        rows: Indices,
        poses: Array,
        twists: Array,
        slips: Array,
        reported: Array,
        measured: Array,
    ) -> None: ...
