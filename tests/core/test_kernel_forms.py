"""The tests of the kernels pass with interpreted kernels, too, as where there is no compiler."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from swarmd.core.kernels import KERNELS, describe_kernels, files_of, source_of
from tests.support.examples import part

ROOT = Path(__file__).resolve().parents[2]
WITHOUT = "not integration and not evidence and not compiled_only"


PASSED = ROOT / "build" / "interpreted.json"
"""By the folder of tests, the digest of what passed interpreted."""
FOLDERS = sorted(
    {f"tests/{Path(source_of(name)).parent}".replace("/swarmd/", "/") for name in KERNELS}
)
"""Of the tests of kernels."""


def digest(folder: str, root: Path = ROOT) -> str:
    """The digest of all kernels, of the tests in a folder and their rigs, and of the versions."""
    files = {root / file for name in KERNELS for file in files_of(name)}
    files |= {root / name for name in ("constraints.txt", "tests/conftest.py")}
    files |= {*(root / folder).rglob("*.py"), *(root / "tests/support").rglob("*.py")}
    found = hashlib.sha256(sys.version.encode())
    for path in sorted(path for path in files if path.exists()):
        found.update(f"{path.relative_to(root)} {path.stat().st_size} ".encode())
        found.update(path.read_bytes())
    return found.hexdigest()


def passed() -> dict[str, str]:
    return dict(json.loads(PASSED.read_text())) if PASSED.exists() else {}


@pytest.mark.integration
@pytest.mark.long
@pytest.mark.skipif(describe_kernels() != "compiled", reason="the kernels are not compiled")
@pytest.mark.timeout(1200)  # of all; each test in there has its own
@pytest.mark.parametrize("rows", part(["first"], ["all"]))
def test_tests_of_kernels_pass_interpreted(rows: str) -> None:
    """In another process, since modules keep the form that they have loaded.

    `make test` runs the first row of each test, with a third of the examples: compiled, all rows
    check the values. It leaves out folders whose tests have passed with these very kernels.
    """
    digests = {folder: digest(folder) for folder in FOLDERS}
    folders = [one for one in FOLDERS if rows == "all" or passed().get(one) != digests[one]]
    if not folders:
        return
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider"]
    if rows == "first":
        command += ["-ptests.support.first_rows", "--hypothesis-profile=interpreted"]
    environ = {**os.environ, "SWARMD_COMPILED": "0"}
    command += ["-m", WITHOUT, *folders]
    done = subprocess.run(command, cwd=ROOT, env=environ, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    PASSED.parent.mkdir(exist_ok=True)
    text = json.dumps({**passed(), **{one: digests[one] for one in folders}}, indent=1)
    PASSED.with_suffix(".new").write_text(text)
    PASSED.with_suffix(".new").replace(PASSED)


def test_a_change_of_a_kernel_concerns_all_folders_and_that_of_a_test_its_own(
    tmp_path: Path,
) -> None:
    def write(name: str, text: str) -> None:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)

    for name in (*map(source_of, KERNELS), "constraints.txt", "tests/conftest.py"):
        write(name, "")
    write("tests/robot/test_a.py", "")

    def digests() -> list[str]:
        return [digest(folder, tmp_path) for folder in ("tests/robot", "tests/robot/sensing")]

    before = digests()
    write(source_of(KERNELS[0]), "x = 1")
    after = digests()
    assert [a == b for a, b in zip(before, after, strict=True)] == [False, False]
    write("tests/robot/test_a.py", "x = 1")
    assert [a == b for a, b in zip(after, digests(), strict=True)] == [False, True]
