"""How much odometry is kept, and how far it is extrapolated."""

MAX_EXTRAPOLATION = 0.15
"""Seconds for which the last measured twist is extrapolated: three odometry periods."""

HISTORY = 40
"""Readings that are kept."""
