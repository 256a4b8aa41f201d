"""How many examples a property test draws: as many as it names under `make evidence` alone."""

from __future__ import annotations

from hypothesis import settings

FULL = 100
"""What hypothesis draws by itself; a profile with fewer draws that share of each number."""


def examples(full: int) -> int:
    """The number of examples under the profile that is loaded, at least 5."""
    return max(full * settings().max_examples // FULL, 5)
