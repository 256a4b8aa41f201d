"""The modules of outcomes by the pattern's name: each has `outcomes(seeds, jobs)`."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

_OWN = ("__init__", "__main__", "catalog", "outcome")


def _modules() -> Mapping[str, Any]:
    names = sorted(path.stem for path in Path(__file__).parent.glob("*.py"))
    return {n: import_module(f"studies.outcomes.{n}") for n in names if n not in _OWN}


MODULES = _modules()
"""Every file of this folder that is about a pattern."""
