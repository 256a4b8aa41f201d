"""The two forms of a kernel, compiled and interpreted, for tests.

A test imports a kernel as other code does, and gets what runs: `make test` runs the tests of
kernels compiled, and tests/core/test_kernel_forms.py runs them once more interpreted, in a process
with SWARMD_COMPILED=0. What is here is for tests that compare both forms, and for those that can
run on one alone.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import patch

import pytest

from swarmd.core.kernel_types import typed
from swarmd.core.kernels import KERNELS, files_of

ROOT = Path(__file__).resolve().parents[2]

compares_forms = pytest.mark.compiled_only(reason="compares both forms")
long_run = pytest.mark.compiled_only(reason="a long simulated run")

_INTERPRETED: dict[str, ModuleType] = {}
"""The interpreted kernels of this process that has compiled ones, by their names."""


@contextmanager
def interpreted_kernels() -> Iterator[None]:
    """In this block, `import` gives the interpreted form of each kernel; always the same module.

    What is not a kernel must have been imported before: it would keep the interpreted form.
    """
    before = _modules()
    compiled = {name: one for name, one in before.items() if hasattr(one, "__unit__")}
    if not compiled:  # one library alone may be older than its sources
        yield
        return
    with patch.dict(os.environ, SWARMD_COMPILED="0"):
        _replace(compiled, _INTERPRETED)
        try:
            yield
        finally:
            fresh = {name: one for name, one in _modules().items() if one is not before.get(name)}
            _replace(fresh, compiled)
    _INTERPRETED.update({name: one for name, one in fresh.items() if name in KERNELS})
    late = fresh.keys() - {*KERNELS}
    assert not late, f"{sorted(late)} have the interpreted form of kernels from now on"


def _modules() -> dict[str, ModuleType]:
    return {name: one for name, one in sys.modules.items() if name.startswith("swarmd.")}


def _replace(old: Mapping[str, ModuleType], new: Mapping[str, ModuleType]) -> None:
    """Let `import` give other modules, and their packages have them as attributes."""
    for name in old:
        package, _, title = name.rpartition(".")
        vars(sys.modules[package]).pop(title, None)
    for name in old:
        del sys.modules[name]
    for name, module in new.items():
        sys.modules[name] = module
        package, _, title = name.rpartition(".")
        setattr(sys.modules[package], title, module)


def both_forms(*names: str) -> tuple[Any, Any]:
    """The interpreted form of kernels and the one in use, which is compiled where possible.

    Each has the names of all these kernels.
    """
    assert {*names} <= {*KERNELS}
    used = [import_module(name) for name in names]
    with interpreted_kernels():
        others = [import_module(name) for name in names]
    interpreted, compiled = (
        SimpleNamespace(**{key: value for module in modules for key, value in vars(module).items()})
        for modules in (others, used)
    )
    return interpreted, compiled


@cache
def typed_text(name: str) -> str:
    """A kernel with the types of C of its `.pxd`, as the compiler reads it."""
    source, declared = (ROOT / file for file in files_of(name))
    return typed(source.read_text(), declared.read_text() if declared.exists() else "", name).text


def interpreted(name: str, *, because: str) -> Any:
    """The interpreted form of a kernel, for a test that cannot run on the compiled one."""
    assert name in KERNELS
    assert because
    import_module(name)  # with all that it imports
    with interpreted_kernels():
        return import_module(name)
