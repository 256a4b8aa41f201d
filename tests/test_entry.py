"""The first moments of the commands, each in a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SLOW = "import signal\nprint('importing', flush=True)\nsignal.pause()\n"


@pytest.mark.parametrize("name", ["swarmctl", "swarmd"])
def test_ctrl_c_while_a_command_is_imported_is_no_traceback(tmp_path: Path, name: str) -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    module, _, function = scripts[name].partition(":")
    (tmp_path / "click.py").write_text(SLOW)
    with subprocess.Popen(
        [sys.executable, "-c", f"from {module} import {function}; {function}()"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == b"importing\n"
        process.send_signal(signal.SIGINT)
        assert process.stderr.read() == b""
        assert process.wait(30) == 130
