"""How late scans arrive: measured by the stamps of one clock, and by turns. Pure.

The delay of a scan is the mean age of its rays when it arrives. Two methods measure it:

- Stamps. Where scan and odometry are stamped by one clock, the fastest odometry of the last second
  tells the time of that clock. The stamp of a scan is the time of its oldest ray, as in ROS. The
  delay of odometry itself goes unnoticed, and so does one that both have for more than a second.
- Turns. The turn between two scans, by circular correlation of their ranges, is compared with the
  turn by odometry at candidate delays, in least squares with a free scale of the odometry. It needs
  a rate of turn that changes: at a constant rate all delays explain the turns alike, and then there
  is no figure. After the temporal calibration of sensors by correlated rotations (Rehder, Siegwart
  and Furgale, IEEE T-RO 2016), with one axis and a grid.

The kernel of scans has the code.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core.kernels import load_kernel

if TYPE_CHECKING:
    from swarmd.sensing.scans import TOLERANCE, ScanDelay, delay_by_stamps
else:
    _kernel = load_kernel("swarmd.sensing.scans")
    TOLERANCE, ScanDelay = _kernel.TOLERANCE, _kernel.ScanDelay
    delay_by_stamps = _kernel.delay_by_stamps

__all__ = ["TOLERANCE", "ScanDelay", "delay_by_stamps"]
