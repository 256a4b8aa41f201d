"""De-skew: the rays of a rotating sensor as it would see them all at the time of the newest ray.

A rotating sensor measures its rays one after the other, and the robot moves meanwhile. Odometry
gives the motion between each ray and the newest one; each return is moved by it (motion distortion
correction: Zhang and Singh, "LOAM: Lidar odometry and mapping in real-time", RSS 2014).

A robot that turns against the sensor leaves a sector unmeasured in each scan: rays of the scan
before fill it. A robot that turns with the sensor measures a sector twice, and both stay. The
kernel of scans has the code.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core.kernels import load_kernel

if TYPE_CHECKING:
    from swarmd.sensing.scans import Deskewer, OdometryHistory
else:
    _kernel = load_kernel("swarmd.sensing.scans")
    Deskewer, OdometryHistory = _kernel.Deskewer, _kernel.OdometryHistory

__all__ = ["Deskewer", "OdometryHistory"]
