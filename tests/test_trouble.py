"""docs/robots/trouble.md is what its generator makes of the drivers' diagnoses."""

from __future__ import annotations

import runpy
from pathlib import Path

GENERATOR = Path(__file__).resolve().parents[1] / "docs" / "robots" / "trouble.py"


def test_the_page_of_trouble_is_up_to_date() -> None:
    """If it is not: `python docs/robots/trouble.py`."""
    made = runpy.run_path(str(GENERATOR))
    assert made["PAGE"].read_text() == made["page"]()
