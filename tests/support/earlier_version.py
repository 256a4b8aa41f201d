"""The programs of an earlier version, which `make earlier` has unpacked in the user's cache.

They run with the packages of this environment, and with interpreted kernels.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.support.processes import CAP
from tests.support.swarmctl import Finished

ROOT = Path(__file__).resolve().parents[2]
(COMMIT,) = re.findall(r"^EARLIER := (\w+)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
CODE = CACHE / "swarmd" / "versions" / COMMIT
ENVIRON: Mapping[str, str] = {"PYTHONPATH": str(CODE), "PYTHONSAFEPATH": "1"}
"""What makes Python import the earlier version, wherever it is started."""
SWARMCTL = (sys.executable, "-c", "from swarmd.cli.entry import swarmctl; swarmctl()")
DAEMON = ("swarmd.cli.daemon",)
"""The module of its daemon."""
PREFIX = ("env", *(f"{name}={text}" for name, text in ENVIRON.items()))
"""Becomes a daemon of the earlier version, as `prefix` of a DaemonProcess."""


def need_earlier_version() -> None:
    """Skip the test, with the reason, if there is no code of the earlier version."""
    if not CODE.is_dir():
        pytest.skip(f"no wheel of {COMMIT[:8]}: make earlier (a shallow clone lacks the commit)")


def earlier_swarmctl(*words: str, environ: Mapping[str, str]) -> Finished:
    """Run `swarmctl` of the earlier version to its end."""
    done = subprocess.run(
        [*SWARMCTL, *words],
        env={**os.environ, **environ, **ENVIRON},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=2.0 * CAP,
        check=False,
    )
    return Finished(done.returncode, done.stdout, done.stderr)


def begin_swarmctl(*words: str, environ: Mapping[str, str], log: Path) -> subprocess.Popen[bytes]:
    """Begin `swarmctl` of the earlier version; all that it writes is in `log`."""
    with log.open("wb") as out:
        return subprocess.Popen(
            [*SWARMCTL, *words],
            env={**os.environ, **environ, **ENVIRON},
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
        )
