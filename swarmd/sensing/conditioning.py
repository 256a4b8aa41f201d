"""Conditioning: gives the scans of every driver one meaning, or rejects them.

A conditioned range is a distance within [range_min, range_max], +inf (no return) or -inf (too close
to measure). No ray is unknown. `ScanConditioner` is a class of the kernel of scans.
"""

from __future__ import annotations

import math

import numpy as np

from swarmd.core.values import Array

MAX_REPEATS = 3  # repeats of a noisy sensor after which its scan counts as frozen
COMPARED_SCANS = 4  # with which a repeat is compared: a driver may resend any of its buffers
MIN_DISTINCT_RETURNS = 8  # a noisy sensor never gives this many equal returns twice


def widest_between_rays(bearings: Array) -> float:
    """The widest angle in rad between neighbouring rays; a full turn for a single ray."""
    turn = 2.0 * math.pi
    rising = np.sort(bearings % turn)
    return float(np.diff(rising, append=rising[0] + turn).max())
