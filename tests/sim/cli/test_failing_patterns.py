"""What `swarmctl exp` says of patterns that fail while their runs go on."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Swarmctl = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.mark.integration
def test_patterns_that_fail_are_told_of(tmp_path: Path, swarmctl: Swarmctl) -> None:
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "boom.py").write_text(
        "from swarmd.api import MovementPattern, Params\n"
        "class Boom(MovementPattern[Params]):\n"
        "    params_type = Params\n"
        "    def drive(self, inputs):\n"
        "        raise RuntimeError('boom')\n"
    )
    (tmp_path / "one.yaml").write_text(
        "duration: 2\nplugin_dir: plugins\ngroups: {all: {count: 1, pattern: boom}}\n"
    )
    done = swarmctl("exp", "run", tmp_path / "one.yaml", "--seeds", "2")
    assert done.returncode == 0, done.stderr
    assert "patterns failed in 2 runs" in done.stderr
