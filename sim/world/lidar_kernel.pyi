import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array, ScanSpec
from swarmd.sim.world.geometry import Indices
from swarmd.sim.world.lidar import Rays
from swarmd.sim.world.realism import LidarNoise

class Caster:
    def __init__(
        self,
        spec: ScanSpec,
        rays: Rays,
        walls: Array,
        poles: Array,
        edges: Array,
        reach: Array,
        polygon_owners: Indices,
        discs: Array,
        disc_owners: Indices,
    ) -> None: ...
    def cast(
        self,
        poses: Array,
        observers: Indices,
        first: Indices,
        counts: Indices,
        rows: Indices,
        ranges: Array,
    ) -> None: ...

class Errors:
    def __init__(
        self,
        noise: LidarNoise,
        factors: Array,
        reach: Array,
        lost: Array,
        encoded: Array,
        block_dropout: Array,
        normal: Array,
        even: NDArray[np.float32],
    ) -> None: ...
    def measure(self, row: int, ranges: Array) -> None: ...
    def encode(self, row: int, ranges: Array) -> None: ...
