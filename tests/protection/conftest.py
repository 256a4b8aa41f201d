"""Tests of protection run with the compiled kernels, and with the numpy code."""

from __future__ import annotations

import pytest

from swarmd.core.kernels import compiled_kernel

# The modules that decide. Of the others, the long drives run with the path in force.
BOTH_PATHS = {
    "test_arbiter",
    "test_barrier",
    "test_barrier_blind_zone",
    "test_barrier_lost_sector",
    "test_barrier_told",
    "test_blind_zone",
    "test_constraints",
    "test_modes",
}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if metafunc.module.__name__.rpartition(".")[2] in BOTH_PATHS:
        metafunc.parametrize("arithmetic", ["compiled", "numpy"], indirect=True)


@pytest.fixture(autouse=True)
def arithmetic(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The path that a test runs with, if it says so."""
    path = getattr(request, "param", None)
    if path == "numpy":
        monkeypatch.setenv("SWARMD_COMPILED", "0")
    elif path == "compiled" and compiled_kernel("swarmd.protection.barrier_kernel") is None:
        pytest.skip("the kernels are not compiled")
