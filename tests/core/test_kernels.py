"""Which code decides: compiled kernels or numpy."""

from __future__ import annotations

import subprocess
import sys

import pytest

from swarmd.core import kernels
from swarmd.core.kernels import KERNELS, describe_kernels, load_kernel


def test_no_kernel_is_loaded_where_numpy_is_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SWARMD_COMPILED", "0")
    assert [load_kernel(name) for name in KERNELS] == [None] * len(KERNELS)
    assert describe_kernels() == "numpy (SWARMD_COMPILED=0)"


def test_a_kernel_that_was_not_built_is_none_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    monkeypatch.setattr(kernels, "KERNELS", ("swarmd.protection.absent_kernel",))
    assert load_kernel("swarmd.protection.absent_kernel") is None
    assert describe_kernels() == "numpy (not compiled)"
    monkeypatch.setattr(kernels, "KERNELS", (*KERNELS, "swarmd.protection.absent_kernel"))
    monkeypatch.setattr(kernels, "_is_built", lambda name: "absent" not in name)
    assert describe_kernels() == "compiled, but not absent"


def test_a_description_imports_no_kernel() -> None:
    script = (
        "import sys; from swarmd.core.kernels import describe_kernels; describe_kernels();"
        "print([name for name in sys.modules if name.endswith('_kernel') or name == 'numpy'])"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
