"""The outcomes of each pattern: `outcome.py` of its folder, with `outcomes(seeds, jobs)`."""

from __future__ import annotations

from importlib import import_module

from studies.outcomes.outcome import PATTERNS

MODULES = {
    path.parent.name: import_module(f"swarmd.patterns.{path.parent.name}.outcome")
    for path in sorted(PATTERNS.glob("*/outcome.py"))
}
