"""The modules of outcomes by the pattern's name: each has `outcomes(seeds, jobs)` and `MUTANTS`."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.mutations import Mutant

_OWN = ("__init__", "__main__", "catalog", "outcome")


def _modules() -> Mapping[str, Any]:
    names = sorted(path.stem for path in Path(__file__).parent.glob("*.py"))
    return {n: import_module(f"benchmarks.outcomes.{n}") for n in names if n not in _OWN}


MODULES = _modules()
"""Every file of this folder that is about a pattern."""
MUTANTS: tuple[Mutant, ...] = tuple(m for one in MODULES.values() for m in one.MUTANTS)
"""Wrong implementations that the outcomes must notice."""
