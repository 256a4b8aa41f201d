from swarmd.core.values import Array
from swarmd.protection.compiled_barrier import Derived
from swarmd.protection.footprint import Footprint
from swarmd.protection.settings import BarrierSettings

class BarrierKernel:
    moved_x: float
    moved_y: float
    moved_yaw: float
    seconds: float
    linear: float
    angular: float
    min_gap: float | None
    def __init__(self, settings: BarrierSettings, outline: Footprint, derived: Derived) -> None: ...
    def reading(
        self,
        stamp: float,
        x: float,
        y: float,
        yaw: float,
        linear: float,
        angular: float,
        lateral: float,
    ) -> None: ...
    def begin_scan(
        self,
        now: float,
        age: float,
        newest_age: float,
        delay: float,
        odometry_age: float,
        ages: Array,
    ) -> bool: ...
    def set_rays(self, directions: Array) -> None: ...
    def find_min_gap(self, ranges: Array, range_min: float) -> None: ...
    def take_scan(self, ranges: Array, range_min: float, ages: Array, hidden: Array) -> None: ...
    def set_touch(self, bearing: float, half_width: float, speed: float, table: Array) -> None: ...
    def set_told(self, told: Array) -> None: ...
    def end_touch(self) -> None: ...
    def decide(
        self,
        now: float,
        scan_age: float,
        odometry_age: float,
        has_odometry: bool,
        along_x: float,
        along_y: float,
        limit: float,
        speed: float,
        angular: float,
        command_linear: float,
        command_angular: float,
        command_lateral: float,
    ) -> int: ...
    def report(self) -> list[tuple[float, float, float]]: ...
