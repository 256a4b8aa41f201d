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
drivers: {real: {command_timeout: base}}
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
def test_sighup_is_ignored_under_nohup(tmp_path: Path) -> None:
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


def test_1_and_a_traceback_for_an_unforeseen_error(tmp_path: Path) -> None:
    done = swarmd(tmp_path, "--id", "r1", "--driver", "wrong")
    assert done.returncode == 1
    assert "ZeroDivisionError" in done.stderr


@pytest.fixture
def unprotected(tmp_path: Path) -> tuple[str, ...]:
    """Options for a platform without protection."""
    (tmp_path / "bare.yaml").write_text(UNPROTECTED)
    return ("--id", "r1", "--platform", "bare.yaml", "--driver")


def test_2_for_a_real_robot_without_protection(
    tmp_path: Path, unprotected: tuple[str, ...]
) -> None:
    done = swarmd(tmp_path, *unprotected, "real")
    assert done.returncode == 2
    assert "protection.mode" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "connected").exists()


@pytest.mark.parametrize(("driver", "is_found"), [("real", True), ("simulated", False)])
def test_check_finds_a_real_robot_without_protection(
    tmp_path: Path, unprotected: tuple[str, ...], driver: str, is_found: bool
) -> None:
    done = swarmd(tmp_path, *unprotected, driver, "--check")
    lines = [line for line in done.stdout.splitlines() if line.startswith("FAIL")]
    assert any("protection.mode" in line for line in lines) is is_found
    assert done.returncode == 1  # the simulated driver finds no world


@pytest.mark.integration
def test_3_if_the_id_is_held(tmp_path: Path) -> None:
    swarm = unique_swarm()
    with DaemonProcess(tmp_path / "a", swarm=swarm, robot="r1", endpoint="tcp/127.0.0.1:9") as one:
        one.wait_ready()
        done = swarmd(tmp_path / "b", "--id", "r1", "--swarm", swarm)
        assert done.returncode == 3
        assert "'r1'" in done.stderr.splitlines()[-1]
        assert one.process.poll() is None


def test_4_without_a_network(tmp_path: Path) -> None:
    done = swarmd(tmp_path, "--id", "r1", "--profile", "field", "--interface", "wlan77")
    assert done.returncode == 4
    assert "'wlan77'" in done.stderr.splitlines()[-1]


def test_5_for_a_driver_that_cannot_be_used(tmp_path: Path) -> None:
    done = swarmd(tmp_path, "--id", "r1", "--driver", "unusable")
    assert (done.returncode, done.stderr.count("\n")) == (5, 1)
    assert "/dev/ttyACM0" in done.stderr
