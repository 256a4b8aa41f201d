"""The two forms of a kernel, compiled and interpreted, for tests.

A test gets a kernel as other code does: by `load_kernel`, or from the module that re-exports it.
Then the process decides about the form of all kernels together: `make test` runs the tests of
kernels compiled, and tests/core/test_kernel_forms.py runs them once more interpreted. The functions
here are for tests that compare both forms, and for those that can run on one alone.
"""

from __future__ import annotations

from importlib import import_module
from types import SimpleNamespace
from typing import Any

import pytest

from swarmd.core.kernels import KERNELS, load_kernel

compares_forms = pytest.mark.compiled_only(reason="compares both forms")
long_run = pytest.mark.compiled_only(reason="a long simulated run")


def both_forms(*names: str) -> tuple[Any, Any]:
    """The interpreted form of kernels and the one in use, which is compiled where possible.

    Each has the names of all these kernels.
    """
    assert {*names} <= {*KERNELS}
    forms = ([form(name) for name in names] for form in (import_module, load_kernel))
    interpreted, used = (
        SimpleNamespace(**{key: value for module in modules for key, value in vars(module).items()})
        for modules in forms
    )
    return interpreted, used


def interpreted(name: str, *, because: str) -> Any:
    """The interpreted form of a kernel, for a test that cannot run on the compiled one."""
    assert name in KERNELS
    assert because
    return import_module(name)
