"""What patterns are, asked of a child process: neither swarmctl nor swarmd imports plugin code."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from swarmd.errors import PluginError

Row = dict[str, Any]
_PATIENCE = 20.0


def describe_patterns(names: Sequence[str], plugin_dir: Path | None, platform: str) -> list[Row]:
    """The named patterns (none named: all) as the pattern host's `--describe` says it.

    A pattern that cannot be loaded has a row with `error`. PluginError if the child fails, as
    with a plugin whose import hangs or ends the process.
    """
    # -P: a random.py where this is called is not to shadow a module.
    command = [sys.executable, "-P", "-m", "swarmd.host", "--platform", platform]
    if plugin_dir is not None:
        command += ["--plugin-dir", str(plugin_dir)]
    command += ["--describe", *names]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_PATIENCE, env=environment, check=False
        )
    except subprocess.TimeoutExpired as error:
        text = f"the patterns were not described within {_PATIENCE:.0f} s"
        raise PluginError(f"{text}; the import of one of them hangs") from error
    try:
        rows = json.loads(done.stdout)
    except ValueError as error:
        raise PluginError(_last_line(done.stderr)) from error
    assert isinstance(rows, list)
    return rows


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    line = lines[-1] if lines else "the process that describes patterns ended without a word"
    return line.removeprefix("swarmd.errors.").removeprefix("ConfigError: ")
