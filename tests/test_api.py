"""What an author imports is all there, and drags in nothing that a pattern must not use."""

from __future__ import annotations

import subprocess
import sys

import swarmd.api


def test_every_exported_name_exists_once() -> None:
    names = swarmd.api.__all__
    assert all(hasattr(swarmd.api, name) for name in names)
    assert len(set(names)) == len(names)


def test_importing_it_opens_no_network_and_no_loop() -> None:
    code = "import sys, swarmd.api; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert not loaded & {"zenoh", "asyncio", "mujoco", "click", "rich", "swarmd.network"}
