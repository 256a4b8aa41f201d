"""mypy reads the types of C in kernels, and what others import of them."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CALLER, KERNEL = "swarmd/robot/protection/fence/fence.py", "swarmd/robot/protection/projection.py"
PLANTED = {
    CALLER: 'fence_stops.clearance("edges", 0.0, 0.0, 0.0)',
    KERNEL: "def _planted(row: cython.double[::1]) -> cython.bint: return row[0]",
}


@pytest.mark.integration
def test_mypy_sees_an_error_in_a_kernel_and_in_its_caller(tmp_path: Path) -> None:
    arguments, wanted = [f"--cache-dir={tmp_path}"], set()
    for number, (path, line) in enumerate(PLANTED.items()):
        lines = [*(ROOT / path).read_text().splitlines(), line]
        copy = tmp_path / f"{number}.py"
        copy.write_text("\n".join(lines))
        arguments += ["--shadow-file", path, str(copy)]
        wanted.add((path, len(lines)))
    command = [sys.executable, "-m", "mypy", *arguments, *PLANTED]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout
    found = re.findall(r"^(.*):(\d+): error", told, re.MULTILINE)
    assert {(path, int(line)) for path, line in found} == wanted, told
