"""The memory of obstacles in the blind zone, by the rules of blind_zone_numpy: compiled or not."""

from __future__ import annotations

from swarmd.core.kernels import compiled_kernel
from swarmd.protection import blind_zone_numpy
from swarmd.protection.blind_zone_numpy import BlindZoneMemory

__all__ = ["BlindZoneMemory", "blind_zone_memory"]


def blind_zone_memory(range_min: float, speed: float, period: float) -> BlindZoneMemory:
    """A memory of a sensor blind within `range_min` m, with a scan every `period` s.

    Obstacles approach at up to `speed` m/s.
    """
    module = compiled_kernel("swarmd.protection.blind_zone_kernel") or blind_zone_numpy
    memory: BlindZoneMemory = module.BlindZoneMemory(range_min, speed, period)
    return memory
