"""Random numbers of one robot and one purpose, independent of all others."""

from __future__ import annotations

import numpy as np


def generator(seed: int, purpose: str, robot: str) -> np.random.Generator:
    """The same numbers for the same three, whatever else is in the world; `seed` >= 0."""
    return np.random.default_rng([seed, len(purpose), *purpose.encode(), *robot.encode()])
