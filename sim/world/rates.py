"""How often bodies and radio tell what they know, in Hz: one set for live worlds and lockstep."""

from __future__ import annotations

ODOMETRY_RATE = 20.0
HEARING_RATE = 2.0
READINGS_RATE = 10.0
