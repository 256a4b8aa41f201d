"""The distance from walls at which a robot may be set down."""

from __future__ import annotations

import numpy as np

from swarmd.core.messages import NarrowestPassage, SetDown
from swarmd.core.values import Platform
from swarmd.robot.protection.compatibility import barrier_settings


def set_down(platform: Platform, passage: NarrowestPassage | None) -> SetDown | None:
    """Where protection lets a robot drive off at once; None in another mode than `barrier`.

    The gap is that on each side in the narrowest corridor: there the robot drives along a wall, and
    nearer a turn would swing a corner to what may be unseen. docs/evidence/beside.md has the runs.

    `passage`: what the mode of the platform says.
    """
    settings = barrier_settings(platform)
    if passage is None or settings is None:
        return None
    width = 2.0 * float(np.abs(platform.footprint[:, 1]).max())
    return SetDown(
        gap=0.5 * (passage.corridor - width),
        lidar=settings.keep_out,
        unseen=settings.unseen_extent,
    )
