"""How much a long test does: all that it names under `make evidence` alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import settings

FULL = 100
"""What hypothesis draws by itself; a profile with fewer draws that share of each number."""


def examples(full: int) -> int:
    """The number of examples under the profile that is loaded, at least 5."""
    return max(full * settings().max_examples // FULL, 5)


def part(short: Sequence[Any], more: Sequence[Any]) -> list[Any]:
    """Parameters of a long test; those of `more` are evidence."""
    marks = pytest.mark.evidence
    rest = (pytest.param(*one, marks=marks) if isinstance(one, tuple) else
            pytest.param(one, marks=marks) for one in more)  # fmt: skip
    return [*short, *rest]
