"""The build of the kernels."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from swarmd.core.kernels import KERNELS, source_of

pytestmark = pytest.mark.integration

pytest.importorskip("Cython")
SETUP = Path(__file__).parents[2] / "setup.py"
FALSE = shutil.which("false")


def copy_setup(folder: Path) -> None:
    """Copy setup.py, and the files with the list of the libraries and with the types of C."""
    shutil.copy(SETUP, folder)
    core = Path("swarmd", "core")
    (folder / core).mkdir(parents=True)
    for name in ("kernels.py", "kernel_types.py"):
        shutil.copy(SETUP.parent / core / name, folder / core)


@pytest.mark.skipif(FALSE is None, reason="no program that always fails")
def test_build_goes_on_without_a_kernel_that_does_not_compile(tmp_path: Path) -> None:
    copy_setup(tmp_path)
    for name in KERNELS:
        kernel = tmp_path / source_of(name)
        kernel.parent.mkdir(parents=True, exist_ok=True)
        kernel.write_text("import cython\n")
    command = [sys.executable, "setup.py", "build_ext", "--build-lib", "built"]
    environment = {**os.environ, "CC": str(FALSE)}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "swarmd._trusted" in done.stderr  # it says so
    assert not list(tmp_path.glob("built/**/*.so"))


def test_nothing_is_compiled_if_that_is_not_wanted(tmp_path: Path) -> None:
    """No Cython, no sources: `make demo` starts before the kernels are compiled."""
    copy_setup(tmp_path)
    (tmp_path / "Cython.py").write_text("raise ImportError('not installed yet')\n")
    command = [sys.executable, "setup.py", "build_ext", "--inplace"]
    environment = {**os.environ, "SWARMD_COMPILED": "0"}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "build").exists()
    refused = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "not installed yet" in refused.stderr
