"""What a scan and a reading of odometry pass in a robot, as classes of the kernel of scans."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core.kernels import load_kernel

if TYPE_CHECKING:
    from swarmd.sensing.scans import (
        BlindSectors,
        Deskewer,
        OdometryHistory,
        ScanConditioner,
        ScanDelay,
    )
else:
    _kernel = load_kernel("swarmd.sensing.scans")
    BlindSectors, ScanConditioner = _kernel.BlindSectors, _kernel.ScanConditioner
    OdometryHistory, ScanDelay = _kernel.OdometryHistory, _kernel.ScanDelay
    Deskewer = _kernel.Deskewer

__all__ = ["BlindSectors", "Deskewer", "OdometryHistory", "ScanConditioner", "ScanDelay"]
