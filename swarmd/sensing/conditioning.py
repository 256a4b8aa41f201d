"""Conditioning: gives the scans of every driver one meaning, or rejects them.

A conditioned range is a distance within [range_min, range_max], +inf (no return) or -inf (too close
to measure). No ray is unknown. The kernel of scans has the code.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core.kernels import load_kernel

if TYPE_CHECKING:
    from swarmd.sensing.scans import (
        COMPARED_SCANS,
        MAX_REPEATS,
        MIN_DISTINCT_RETURNS,
        BlindSectors,
        ScanConditioner,
    )
else:
    _kernel = load_kernel("swarmd.sensing.scans")
    BlindSectors, ScanConditioner = _kernel.BlindSectors, _kernel.ScanConditioner
    COMPARED_SCANS, MAX_REPEATS = _kernel.COMPARED_SCANS, _kernel.MAX_REPEATS
    MIN_DISTINCT_RETURNS = _kernel.MIN_DISTINCT_RETURNS

__all__ = [
    "COMPARED_SCANS",
    "MAX_REPEATS",
    "MIN_DISTINCT_RETURNS",
    "BlindSectors",
    "ScanConditioner",
]
