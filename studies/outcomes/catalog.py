"""The outcomes of each pattern: `outcome.py` of its folder, with `outcomes(seeds, jobs)`."""

from __future__ import annotations

from importlib import import_module

from studies.outcomes.outcome import PATTERNS, SHORT_SEED, Outcome

MODULES = {
    path.parent.name: import_module(f"swarmd.patterns.{path.parent.name}.outcome")
    for path in sorted(PATTERNS.glob("*/outcome.py"))
}


def short_outcomes(pattern: str) -> list[Outcome]:
    """The outcomes of one seed, in the short form of the pattern if it has one."""
    module = MODULES[pattern]
    found: list[Outcome] = module.outcomes((SHORT_SEED,), **getattr(module, "SHORT_FORM", {}))
    return found
