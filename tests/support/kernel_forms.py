"""The two forms of a kernel, compiled and interpreted, for tests.

A test gets a kernel as other code does: by `load_kernel`, or from the module that re-exports it.
Then the process decides about the form of all kernels together: `make test` runs the tests of
kernels compiled, and tests/core/test_kernel_forms.py runs them once more interpreted. The functions
here are for tests that compare both forms, and for those that can run on one alone.
"""

from __future__ import annotations

import ast
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.kernels import KERNELS, load_kernel

SETUP = Path(__file__).parents[2] / "setup.py"

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


def part(name: str, file: str) -> Any:
    """What holds the names of a part of a kernel: the library in use, or the part's own module."""
    kernel = load_kernel(name)
    is_compiled = kernel.__name__ != name
    return kernel if is_compiled else import_module(f"{name.rpartition('.')[0]}.{file}")


@cache
def table_of_setup(name: str) -> Any:
    """The value of a table of setup.py."""
    for node in ast.parse(SETUP.read_text()).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            if ast.unparse(target) == name:
                return ast.literal_eval(node.value)
    raise AssertionError(f"setup.py has no table {name}")


def kernel_sources() -> dict[str, tuple[str, ...]]:
    """By kernel, the paths of its sources; its own file is the last."""
    parts = table_of_setup("PARTS")
    return {name: (*parts.get(path, ()), path) for name, path in table_of_setup("KERNELS").items()}
