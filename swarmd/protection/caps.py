"""How fast a robot may close on something: the heart of mode `barrier`.

A cap s is the closing speed from which the robot can still stop before whatever it closes on has
used up the gap. The passive one follows the idea of the dynamic window with moving obstacles and
"passive safety" (Mitsch, Ghorbal, Vogelbacher and Platzer, IJRR 2017); the reciprocal one that of
barrier certificates that share the distance (Wang, Ames and Egerstedt, IEEE T-RO 2017).
"""

from __future__ import annotations

import numpy as np

from swarmd.values import Array


def passive_caps(
    room: Array, braking: Array, others_speed: float, unseen: Array | float, tick: float
) -> Array:
    """Closing speeds (k,) in m/s for obstacles that may come at `others_speed`.

    `room` (k,) m is the gap less what must stay free; `braking` (k,) m/s2 how fast the closing
    speed can be shed; `unseen` s (or (k,)) how long the obstacle has moved unseen; `tick` s until
    the next decision. Solves s tick + s^2 / 2b + V (unseen + tick + s / b) = room.
    """
    left = room - others_speed * (unseen + tick)
    linear = braking * tick + others_speed
    roots = np.sqrt(linear * linear + 2.0 * braking * np.maximum(left, 0.0)) - linear
    caps: Array = np.maximum(roots, 0.0)
    return caps


def reciprocal_caps(room: Array, braking: Array, unseen: Array | float, tick: float) -> Array:
    """Closing speeds (k,) in m/s towards others that do the same: each may use half the room.

    As `passive_caps`, with others at rest and a reaction of two ticks and the time unseen.
    """
    half: Array = 0.5 * np.maximum(room, 0.0)
    linear = braking * (2.0 * tick + unseen)
    caps: Array = np.maximum(np.sqrt(linear * linear + 2.0 * braking * half) - linear, 0.0)
    return caps
