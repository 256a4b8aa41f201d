"""Independent random generators for each robot and purpose."""

from __future__ import annotations

import numpy as np


def generator(seed: int, purpose: str, robot: str) -> np.random.Generator:
    """The generator of these three alone, whatever else is in the world; `seed` >= 0."""
    return np.random.default_rng([seed, len(purpose), *purpose.encode(), *robot.encode()])
