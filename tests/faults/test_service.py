"""The daemon as its unit runs it: restricted, and with zero after its end."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from swarmd.core.clock import boottime
from swarmd.daemon.systemd import unit_text
from tests.faults.conftest import ROBOT
from tests.support import unit_sandbox
from tests.support.processes import end_process, wait_until, watchdogs
from tests.support.swarmctl import fork_command

if TYPE_CHECKING:
    from tests.faults.conftest import Bench

pytestmark = pytest.mark.integration


def test_the_base_gets_zero_although_daemon_and_watchdog_were_killed(bench: Bench) -> None:
    bench.driver_options = {"command_timeout": "none"}
    bench.start()
    bench.drive()
    for pid in watchdogs(bench.swarm, ROBOT):
        end_process(pid)
    bench.daemon.kill()
    wait_until(lambda: not watchdogs(bench.swarm, ROBOT), "the watchdog has ended")
    unit = unit_sandbox.settings_of(unit_text(Path("swarmd"), bench.folder / f"{ROBOT}.yaml"))
    (line,) = unit["ExecStopPost"]
    ended = boottime()
    done = fork_command("swarmd", *shlex.split(line.removeprefix("-"))[1:], cwd=bench.folder)
    assert (done.returncode, done.stderr) == (0, "")
    zero = bench.body.wait_zero(ended)
    assert not bench.body.moved_since(zero.at)


def test_zero_for_a_base_that_is_not_reached_is_not_claimed(tmp_path: Path) -> None:
    config = tmp_path / "r1.yaml"
    config.write_text(
        "id: r1\nplatform: burger\ndriver: rmw_zenoh\ndriver_options: {endpoint: tcp/127.0.0.1:9}\n"
    )
    done = fork_command("swarmd", "stop-base", "--config", config, "--within", "0.5s", cwd=tmp_path)
    assert done.returncode == 5
    assert "not reached" in done.stderr


@pytest.mark.skipif(
    os.geteuid() != 0 or not all(map(shutil.which, ("setpriv", "systemd-analyze"))),
    reason="needs root, setpriv and systemd-analyze",
)
def test_a_daemon_drives_under_the_restrictions_of_its_unit(bench: Bench, tmp_path: Path) -> None:
    unit = tmp_path / "swarmd.service"
    unit.write_text(unit_text(Path("/bin/true")))
    restricted = [sys.executable, unit_sandbox.__file__, str(unit)]
    without = ["setpriv", "--bounding-set=-all", "--inh-caps=-all", "--no-new-privs"]
    bench.prefix = (*without, *restricted)
    tried = "import mmap; mmap.mmap(-1, 4096, prot=mmap.PROT_WRITE | mmap.PROT_EXEC)"
    done = subprocess.run(
        [*bench.prefix, sys.executable, "-c", tried], capture_output=True, text=True, check=False
    )
    if "PR_SET_MDWE" in done.stderr:
        pytest.skip("this kernel has no PR_SET_MDWE; Linux 6.3 has it")
    assert "PermissionError" in done.stderr, "the restrictions are in force"
    bench.start()
    bench.drive()
    assert "PermissionError" not in bench.daemon.text()
    sandbox = bench.status().health.sandbox
    assert sandbox is not None
    assert sandbox.missing == ""
