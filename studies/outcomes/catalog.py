"""The outcomes of each pattern: its module in `patterns`, with `outcomes(seeds, jobs)`."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from studies.outcomes import patterns
from studies.outcomes.outcome import SHORT_SEED, Outcome

MODULES = {
    name: import_module(f"{patterns.__name__}.{name}")
    for _, name, _ in iter_modules(patterns.__path__)
}


def short_outcomes(pattern: str) -> list[Outcome]:
    """The outcomes of one seed, in the short form of the pattern if it has one."""
    module = MODULES[pattern]
    found: list[Outcome] = module.outcomes((SHORT_SEED,), **getattr(module, "SHORT_FORM", {}))
    return found
