"""The outcomes of each pattern: its rows, or its module in `patterns`.

A pattern has rows in `patterns/<name>/outcomes.yaml` (`rows.RowsOf`), or a module with
`outcomes(seeds, jobs)` for what rows cannot say. A module may add to rows.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from studies.outcomes import patterns
from studies.outcomes.outcome import SHORT_SEED, Outcome, patterns_with_rows
from studies.outcomes.rows import RowsOf

_PYTHON = {
    name: import_module(f"{patterns.__name__}.{name}")
    for _, name, _ in iter_modules(patterns.__path__)
}
MODULES: dict[str, Any] = {
    name: _PYTHON[name] if name in _PYTHON else RowsOf(name)
    for name in sorted({*_PYTHON, *patterns_with_rows()})
}


def short_outcomes(pattern: str) -> list[Outcome]:
    """The outcomes of one seed, in the short form of the pattern if it has one."""
    module = MODULES[pattern]
    found: list[Outcome] = module.outcomes((SHORT_SEED,), **getattr(module, "SHORT_FORM", {}))
    return found
