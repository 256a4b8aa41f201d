from swarmd.core.values import Array
from swarmd.sim.world.base_dynamics import Actuators, BaseDynamics

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
