"""The tests of the kernels pass with interpreted kernels, too, as where there is no compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from studies.mutants import TESTS
from swarmd.core.kernels import describe_kernels
from tests.support.examples import part

ROOT = Path(__file__).resolve().parents[2]
WITHOUT = "not integration and not evidence and not compiled_only"


@pytest.mark.skipif(describe_kernels() != "compiled", reason="the kernels are not compiled")
@pytest.mark.timeout(1200)  # of all; each test in there has its own
@pytest.mark.parametrize("rows", part(["-ptests.support.first_rows"], [""]), ids=["first", "all"])
def test_tests_of_kernels_pass_interpreted(rows: str) -> None:
    """In another process, since modules keep the form that they have loaded.

    `make test` runs the first row of each test: compiled, all rows check the values.
    """
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider"]
    command += ["-m", WITHOUT, *filter(None, [rows]), *sorted({*TESTS.values()})]
    environ = {**os.environ, "SWARMD_COMPILED": "0"}
    done = subprocess.run(command, cwd=ROOT, env=environ, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
