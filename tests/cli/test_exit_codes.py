"""How `swarmd` ends: a supervisor can tell from the exit code what to do."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.processes import DaemonProcess, unique_swarm

DRIVER = """
from pathlib import Path

from swarmd.core.errors import DriverError


def unusable(**options):
    raise DriverError("no base on /dev/ttyACM0; plug it in")


def wrong(**options):
    return 1 / 0


class Real:
    is_simulated = False

    def __init__(self, **options):
        pass

    async def check(self, seconds):
        return ()

    async def run(self, sink):
        Path("connected").touch()

    def send(self, twist, scan_seq, requested_scan_seq):
        Path("connected").touch()
"""
UNPROTECTED = """extends: burger
protection: {mode: off}
drivers: {real: {deadman: base}}
"""


def swarmd(folder: Path, *args: str) -> subprocess.CompletedProcess[str]:
    """A daemon that is expected to end by itself, with three drivers more to choose from."""
    info = folder / "outsider-1.dist-info"
    info.mkdir(parents=True, exist_ok=True)
    (info / "METADATA").write_text("Name: outsider\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[swarmd.drivers]\nunusable = outsider_driver:unusable\nwrong = outsider_driver:wrong\n"
        "real = outsider_driver:Real\n"
    )
    (folder / "outsider_driver.py").write_text(DRIVER)
    return subprocess.run(
        [sys.executable, "-m", "swarmd.cli.daemon", "--state-dir", str(folder / "state"), *args],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder), "SWARM": unique_swarm()},
        timeout=60,
        check=False,
    )


@pytest.mark.integration
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_0_after_a_clean_stop(tmp_path: Path, number: signal.Signals) -> None:
    swarm = unique_swarm()
    with DaemonProcess(tmp_path, swarm=swarm, robot="r1", endpoint="tcp/127.0.0.1:9") as daemon:
        daemon.wait_ready()
        daemon.send(number)
        assert daemon.process.wait(30) == 0
        assert "Traceback" not in daemon.text()


@pytest.mark.integration
def test_under_nohup_a_terminal_that_goes_ends_nothing(tmp_path: Path) -> None:
    with DaemonProcess(
        tmp_path,
        swarm=unique_swarm(),
        robot="r1",
        endpoint="tcp/127.0.0.1:9",
        prefix=["env", "--ignore-signal=HUP"],
    ) as daemon:
        daemon.wait_ready()
        daemon.send(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            daemon.process.wait(1.0)
        assert daemon.terminate() == 0


def test_1_and_a_traceback_for_an_error_nobody_foresaw(tmp_path: Path) -> None:
    done = swarmd(tmp_path, "--id", "r1", "--driver", "wrong")
    assert done.returncode == 1
    assert "ZeroDivisionError" in done.stderr


def test_2_for_a_driver_that_is_not_there(tmp_path: Path) -> None:
    done = swarmd(tmp_path, "--id", "r1", "--driver", "unusabel")
    assert (done.returncode, done.stderr) == (
        2,
        "error: no driver 'unusabel'; did you mean 'unusable'?\n",
    )


def test_2_for_a_real_robot_without_protection_before_it_is_touched(tmp_path: Path) -> None:
    (tmp_path / "bare.yaml").write_text(UNPROTECTED)
    done = swarmd(tmp_path, "--id", "r1", "--platform", "bare.yaml", "--driver", "real")
    assert (done.returncode, done.stderr) == (
        2,
        "error: platform bare: protection.mode is off, and driver real moves a real robot; wanted"
        " barrier, potential_field or stop_zone: change the platform's file\n",
    )
    assert not (tmp_path / "connected").exists()


def test_check_tells_of_a_real_robot_without_protection(tmp_path: Path) -> None:
    (tmp_path / "bare.yaml").write_text(UNPROTECTED)
    args = ("--id", "r1", "--platform", "bare.yaml", "--check", "--driver")
    done = swarmd(tmp_path, *args, "real")
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("FAIL"))
    assert done.returncode == 1
    assert "protection.mode is off, and driver real moves a real robot" in line
    assert "moves a real robot" not in swarmd(tmp_path, *args, "simulated").stdout


@pytest.mark.integration
def test_3_if_the_id_is_held(tmp_path: Path) -> None:
    swarm = unique_swarm()
    with DaemonProcess(tmp_path / "a", swarm=swarm, robot="r1", endpoint="tcp/127.0.0.1:9") as one:
        one.wait_ready()
        done = swarmd(tmp_path / "b", "--id", "r1", "--swarm", swarm)
        assert done.returncode == 3
        assert done.stderr.splitlines()[-1].startswith("error: robot id 'r1' is held by another")
        assert one.process.poll() is None


def test_4_without_a_network(tmp_path: Path) -> None:
    done = swarmd(tmp_path, "--id", "r1", "--profile", "field", "--interface", "wlan77")
    assert done.returncode == 4
    assert "no network interface 'wlan77' on this machine" in done.stderr.splitlines()[-1]


def test_5_for_a_driver_that_cannot_be_used(tmp_path: Path) -> None:
    done = swarmd(tmp_path, "--id", "r1", "--driver", "unusable")
    assert (done.returncode, done.stderr) == (
        5,
        "error: no base on /dev/ttyACM0; plug it in\n",
    )
