"""The stages that a scan and a reading of odometry pass, compiled where a library exists.

Import the stages from here: the files of the stages give the interpreted classes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core.kernels import load_kernel

if TYPE_CHECKING:
    from swarmd.sensing.blind_sector import BlindSectors
    from swarmd.sensing.conditioning import (
        COMPARED_SCANS,
        MAX_REPEATS,
        MIN_DISTINCT_RETURNS,
        ScanConditioner,
    )
    from swarmd.sensing.delay_by_stamps import delay_by_stamps
    from swarmd.sensing.deskew import Deskewer
    from swarmd.sensing.odometry_history import OdometryHistory
    from swarmd.sensing.scan_delay import TOLERANCE, ScanDelay
else:
    BlindSectors = load_kernel("swarmd.sensing.blind_sector").BlindSectors
    _conditioning = load_kernel("swarmd.sensing.conditioning")
    ScanConditioner = _conditioning.ScanConditioner
    COMPARED_SCANS = _conditioning.COMPARED_SCANS
    MAX_REPEATS = _conditioning.MAX_REPEATS
    MIN_DISTINCT_RETURNS = _conditioning.MIN_DISTINCT_RETURNS
    delay_by_stamps = load_kernel("swarmd.sensing.delay_by_stamps").delay_by_stamps
    Deskewer = load_kernel("swarmd.sensing.deskew").Deskewer
    OdometryHistory = load_kernel("swarmd.sensing.odometry_history").OdometryHistory
    _scan_delay = load_kernel("swarmd.sensing.scan_delay")
    ScanDelay = _scan_delay.ScanDelay
    TOLERANCE = _scan_delay.TOLERANCE

__all__ = [
    "COMPARED_SCANS",
    "MAX_REPEATS",
    "MIN_DISTINCT_RETURNS",
    "TOLERANCE",
    "BlindSectors",
    "Deskewer",
    "OdometryHistory",
    "ScanConditioner",
    "ScanDelay",
    "delay_by_stamps",
]
