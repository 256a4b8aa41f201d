"""The two forms of a kernel, compiled and interpreted, for tests.

A test gets a kernel as other code does: by `load_kernel`, or from the module that re-exports it.
Then the process decides about the form of all kernels together: `make test` runs the tests of
kernels compiled, and tests/core/test_kernel_forms.py runs them once more interpreted. The functions
here are for tests that compare both forms, and for those that can run on one alone.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import pytest

from swarmd.core.kernels import KERNELS, load_kernel

compares_forms = pytest.mark.compiled_only(reason="compares both forms")
long_run = pytest.mark.compiled_only(reason="a long simulated run")


def both_forms(name: str) -> tuple[Any, Any]:
    """The interpreted form of a kernel and the one in use, which is compiled where possible."""
    assert name in KERNELS
    return import_module(name), load_kernel(name)


def interpreted(name: str, *, because: str) -> Any:
    """The interpreted form of a kernel, for a test that cannot run on the compiled one."""
    assert name in KERNELS
    assert because
    return import_module(name)
