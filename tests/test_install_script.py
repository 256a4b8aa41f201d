"""install.sh of the archive: with a tiny swarmd in place of the real one, and no network."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.integration

SCRIPT = Path(__file__).resolve().parent.parent / ".ci" / "install.sh"
BUNDLED = [
    *Path(shutil.__file__).parent.glob("ensurepip/_bundled/pip-*.whl"),
    *Path("/usr/share/python-wheels").glob("pip-*.whl"),
]
PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"

needs_pip = pytest.mark.skipif(not BUNDLED, reason="this Python brings no wheel of pip")


def make_wheel(folder: Path, version: str, *, kernels: str = "compiled") -> None:
    """A wheel of a swarmd with two programs that print its version."""
    info = f"swarmd-{version}.dist-info"
    files = {
        "swarmd/__init__.py": f"def main():\n    print('swarmd {version}')\n",
        "swarmd/core/__init__.py": "",
        "swarmd/core/kernels.py": f"def describe_kernels():\n    return {kernels!r}\n",
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: swarmd\nVersion: {version}\n"
        "Provides-Extra: ros\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": "[console_scripts]\nswarmd = swarmd:main\n"
        "swarmctl = swarmd:main\n",
    }
    record = "".join(f"{name},,\n" for name in [*files, f"{info}/RECORD"])
    with zipfile.ZipFile(folder / f"swarmd-{version}-py3-none-any.whl", "w") as wheel:
        for name, text in {**files, f"{info}/RECORD": record}.items():
            wheel.writestr(name, text)


def make_archive(
    folder: Path, version: str, *, machine: str | None = None, pythons: str = PYTHON
) -> Path:
    """An archive as .ci/build-archive makes it, unpacked."""
    archive = folder / f"archive-{version}"
    (archive / "wheels").mkdir(parents=True)
    make_wheel(archive / "wheels", version)
    for wheel in BUNDLED[:1]:
        shutil.copy(wheel, archive / "wheels")
    text = SCRIPT.read_text().replace("@VERSION@", version).replace("@EXTRAS@", "ros")
    text = text.replace("@MACHINE@", machine or platform.machine()).replace("@PYTHONS@", pythons)
    (archive / "install.sh").write_text(text)
    (archive / "install.sh").chmod(0o755)
    write_sums(archive)
    return archive


def write_sums(archive: Path) -> None:
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(archive)}\n"
        for path in sorted(archive.rglob("*"))
        if path.is_file() and path.name != "SHA256SUMS"
    ]
    (archive / "SHA256SUMS").write_text("".join(lines))


def install(archive: Path, prefix: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [archive / "install.sh", "--prefix", prefix, "--no-links", *words],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "HOME": str(prefix.parent)},
    )


def refused(done: subprocess.CompletedProcess[str], prefix: Path, subject: str) -> None:
    """It ended with one line about the subject, and left nothing behind."""
    assert done.returncode == 1, done.stdout
    assert subject in done.stderr.splitlines()[-1]
    assert not prefix.exists() or not list(prefix.iterdir())


def test_an_archive_for_another_machine_is_refused(tmp_path: Path) -> None:
    archive = make_archive(tmp_path, "1.0", machine="riscv64")
    refused(install(archive, tmp_path / "opt"), tmp_path / "opt", "riscv64")


def test_a_damaged_archive_is_refused(tmp_path: Path) -> None:
    archive = make_archive(tmp_path, "1.0")
    make_wheel(archive / "wheels", "1.0", kernels="changed")
    refused(install(archive, tmp_path / "opt"), tmp_path / "opt", "damaged")


def test_without_a_python_that_will_do_nothing_is_left_behind(tmp_path: Path) -> None:
    archive = make_archive(tmp_path, "1.0", pythons="2.7")
    refused(install(archive, tmp_path / "opt"), tmp_path / "opt", "2.7")
    done = install(archive, tmp_path / "opt", "--python", sys.executable)
    refused(done, tmp_path / "opt", sys.executable)


@needs_pip
def test_a_new_version_replaces_the_one_before_once_it_is_complete(tmp_path: Path) -> None:
    prefix = tmp_path / "opt"
    done = install(make_archive(tmp_path, "1.0"), prefix)
    assert done.returncode == 0, done.stderr
    first = (prefix / "current").resolve()
    assert run(prefix) == "swarmd 1.0"
    again = install(tmp_path / "archive-1.0", prefix)
    assert (again.returncode, (prefix / "current").resolve()) == (0, first)

    broken = make_archive(tmp_path, "2.0")
    next((broken / "wheels").glob("pip-*.whl")).write_bytes(b"no wheel")
    write_sums(broken)
    assert install(broken, prefix).returncode != 0
    assert run(prefix) == "swarmd 1.0"
    assert sorted(path.name for path in prefix.iterdir()) == sorted(["bin", "current", first.name])

    done = install(make_archive(tmp_path, "3.0"), prefix)
    assert done.returncode == 0, done.stderr
    assert run(prefix) == "swarmd 3.0"
    assert str(first) in done.stdout
    assert first.exists(), "the way back"


def run(prefix: Path) -> str:
    done = subprocess.run(
        [prefix / "bin" / "swarmd"], capture_output=True, text=True, timeout=30, check=True
    )
    return done.stdout.strip()
