"""The tests of the kernels pass with interpreted kernels, too, as where there is no compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import chain
from pathlib import Path

import pytest

from studies.kernel_mutants import TESTS
from swarmd.core.kernels import describe_kernels

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.skipif(describe_kernels() != "compiled", reason="the kernels are not compiled")
@pytest.mark.timeout(900)  # of each test in there: 180 s
@pytest.mark.parametrize("folder", sorted({*chain(*TESTS.values())}))
def test_interpreted(folder: str) -> None:
    """Each in a process of its own, since modules keep the form that they have loaded."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-x",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
    ]
    command += ["-m", "not integration and not evidence and not compiled_only", folder]
    environ = {**os.environ, "SWARMD_COMPILED": "0"}
    done = subprocess.run(command, cwd=ROOT, env=environ, capture_output=True, text=True)
    print(done.stdout)
    assert done.returncode == 0, done.stderr
