"""What several files of these tests use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import pytest


@pytest.fixture
def left() -> Iterator[ExitStack]:
    """What a test leaves behind, which ends with it."""
    with ExitStack() as stack:
        yield stack
