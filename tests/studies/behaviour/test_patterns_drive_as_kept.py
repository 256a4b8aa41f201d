"""Every pattern drives its robots as the ledger of behaviours has it, to the bit."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies.behaviour.scenes import SCENES
from tests.support.behaviour import PATTERNS, assert_drives_as_kept

pytestmark = pytest.mark.compiled_only(reason="eleven times as dear; the long lane draws three")


@pytest.mark.parametrize("name", [name for name in SCENES if name in PATTERNS])
def test_robots_drive_as_kept(name: str, tmp_path: Path) -> None:
    assert_drives_as_kept(name, tmp_path)
