"""`swarmd` as a command: settings, checks, and exit codes for a process supervisor."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from swarmd.operator.cli.daemon import exit_code_of
from swarmd.operator.cli.daemon import swarmd as command
from swarmd.operator.cli.swarmctl import run_cli
from swarmd.settings.settings import load_daemon_settings, load_platform
from tests.support.fake_body import Body
from tests.support.processes import (
    CAP,
    DaemonProcess,
    assert_keeps_nothing_of_its_daemon,
    unique_swarm,
)
from tests.support.swarmctl import fork_command

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

    def send(self, twist, scan_seq, requested_scan_seq, *, is_stopped=False):
        Path("connected").touch()
"""
UNPROTECTED = """extends: burger
protection: {mode: off}
drivers: {real: {command_timeout: base}}
"""


def swarmd(*args: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return fork_command("swarmd", *args, cwd=cwd, SWARM="")


@pytest.mark.parametrize(
    ("args", "subject"),
    [
        (["--platform", "wafle_pi"], "'waffle_pi'"),
        (["--id", "TB3"], "'TB3'"),
        (["--driver", "simulted"], "'simulated'"),
        (["--config", "none.yaml"], "none.yaml"),
        (["--config", "twice.yaml"], "twice.yaml:2: "),
        (["--profile", "field"], "`interface`"),
        (["--profile", "feld"], "'feld'"),
        (["--driver-option", "x"], "--driver-option 'x'"),
        (["--chek"], "'--check'"),
        (["--driver-option", "endpont=x"], "endpont"),
        (["stop-bas"], "'stop-base'"),
        (["stop-base", "--config", "none.yaml"], "none.yaml"),
        (["--id", "r1", "stop-base"], "--id"),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_2(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    args: list[str],
    subject: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "twice.yaml").write_text("id: a\nid: b")
    has_id = "--id" in args or "stop-b" in args[0]
    words = args if has_id else [*args, "--id", "r1"]
    assert run_cli(command, words, "swarmd", exit_code_of) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert subject in captured.err
    assert captured.err.count("\n") == 1


@pytest.mark.integration
def test_driver_options_are_read_as_in_a_file(tmp_path: Path) -> None:
    words = ("loop=true", "again=false", "speed=2", "namespace={robot}")
    given = [part for word in words for part in ("--driver-option", word)]
    done = swarmd("--id", "r1", *given, "--print-effective-config", cwd=tmp_path)
    found = yaml.safe_load(done.stdout)["driver_options"]
    assert {"loop": True, "again": False, "speed": 2, "namespace": "{robot}"}.items() <= (
        found.items()
    )


@pytest.mark.integration
def test_the_effective_configuration_has_sources_and_reads_back_the_same(tmp_path: Path) -> None:
    (tmp_path / "swarm.yaml").write_text("swarm: lab\nroster: [r1, r2]\nlabels: {red: [r1]}")
    (tmp_path / "r.yaml").write_text(
        "swarm_file: swarm.yaml\nplatform: burger\ndriver_options: {endpoint: tcp/127.0.0.1:9}\n"
        "touch: {push: {half_width_deg: 20, speed: 0.1}, dock: null}\n"
        "accepts_unseen: {waffle_pi: a fence}\naccepts_faster: [jackal]\n"
        "neighbors: {neighborhood: range, range: 3.0}\n"
        "fence: {frame: map, polygon: [[-4, -4], [4, -4], [4, 4], [-4, 4]]}"
    )
    done = swarmd("--config", "r.yaml", "--id", "r1", "--print-effective-config", cwd=tmp_path)
    lines = [line.split("  #") for line in done.stdout.splitlines() if "  #" in line]
    sources = {line[0].split(":")[0]: line[-1].strip() for line in lines}
    assert done.returncode == 0
    assert sources["id"] == "--id"
    assert sources["swarm"] == "swarm.yaml"
    assert sources["platform"] == "r.yaml"
    assert sources["lease"] == "default"
    (tmp_path / "again.yaml").write_text(done.stdout)
    first = load_daemon_settings(tmp_path / "r.yaml", {"id": "r1"}, {"HOME": str(tmp_path)})
    again = load_daemon_settings(tmp_path / "again.yaml", {}, {})
    same = ("id", "network", "roster", "labels", "driver_options", "state_dir", "platform_name")
    for key in (*same, "robot"):
        assert getattr(again, key) == getattr(first, key)
    assert again.file.neighbors == first.file.neighbors


@pytest.mark.integration
def test_check_finds_problems_and_moves_nothing(tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own/broken.py").write_text("import nothing_of_that_name")
    (tmp_path / "r.yaml").write_text(
        "id: r1\nplugin_dir: own\nroster: [r2]\n"
        "driver_options: {endpoint: tcp/127.0.0.1:9}\n"
        "parameters: {labels: {}, robots: {}}\nlabels: {}\n"
    )
    done = swarmd("--config", "r.yaml", "--check", cwd=tmp_path)
    assert done.returncode == 1
    rows = [re.split("  +", line) for line in done.stdout.splitlines()[1:-1]]
    found = {subject: level for level, subject, *_ in rows}
    assert found["settings"] == found["platform"] == found["patterns"] == "ok"
    assert found["pattern broken"] == "fault"
    assert found["roster"] == "fault"
    assert "nothing_of_that_name" in done.stdout
    assert not (tmp_path / ".local").exists()


@pytest.mark.integration
def test_a_parent_that_has_ended_already_starts_nothing(tmp_path: Path) -> None:
    done = swarmd("--id", "r1", "--die-with-parent", "1", "--check", cwd=tmp_path)
    assert done.stdout == ""


@pytest.mark.integration
def test_check_is_well_with_a_body_and_moves_nothing(tmp_path: Path) -> None:
    swarm = unique_swarm()
    with Body(load_platform("burger"), swarm=swarm, robot="r1") as body:
        args = ["--id", "r1", "--swarm", swarm, "--platform", "burger", "--check"]
        done = swarmd(*args, "--driver-option", f"endpoint={body.endpoint}", cwd=tmp_path)
        assert done.returncode == 0, done.stdout
        assert all(command.twist.is_zero for command in body.commands)


def with_drivers(folder: Path, *args: str) -> subprocess.CompletedProcess[str]:
    """A daemon that is expected to end by itself, with three drivers more to choose from."""
    info = folder / "outsider-1.dist-info"
    info.mkdir(parents=True, exist_ok=True)
    (info / "METADATA").write_text("Name: outsider\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[swarmd.drivers]\nunusable = outsider_driver:unusable\nwrong = outsider_driver:wrong\n"
        "real = outsider_driver:Real\n"
    )
    (folder / "outsider_driver.py").write_text(DRIVER)
    words = ["--state-dir", str(folder / "state"), *args]
    return fork_command("swarmd", *words, cwd=folder, PYTHONPATH=str(folder))


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


@pytest.mark.integration
def test_the_first_host_is_a_fork_of_the_daemon(tmp_path: Path) -> None:
    with DaemonProcess(
        tmp_path,
        swarm=unique_swarm(),
        robot="r1",
        endpoint="tcp/127.0.0.1:9",
        is_forked=False,
    ) as daemon:
        assert_keeps_nothing_of_its_daemon(daemon.wait_ready().process.pid)


@pytest.mark.integration
def test_1_and_a_traceback_for_an_unforeseen_error(tmp_path: Path) -> None:
    done = with_drivers(tmp_path, "--id", "r1", "--driver", "wrong")
    assert done.returncode == 1
    assert "ZeroDivisionError" in done.stderr


@pytest.mark.integration
def test_2_if_too_few_files_may_be_opened(tmp_path: Path) -> None:
    limited = [
        "prlimit",
        "--nofile=64:64",
        sys.executable,
        "-m",
        "swarmd.operator.cli.daemon",
        "--id",
        "r1",
    ]
    done = subprocess.run(limited, capture_output=True, text=True, timeout=CAP, cwd=tmp_path)
    assert done.returncode == 2
    assert "64" in done.stderr
    assert "ulimit" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.fixture
def unprotected(tmp_path: Path) -> tuple[str, ...]:
    """Options for a platform without protection."""
    (tmp_path / "bare.yaml").write_text(UNPROTECTED)
    return ("--id", "r1", "--platform", "bare.yaml", "--driver")


@pytest.mark.integration
def test_2_for_a_real_robot_without_protection(
    tmp_path: Path, unprotected: tuple[str, ...]
) -> None:
    done = with_drivers(tmp_path, *unprotected, "real")
    assert done.returncode == 2
    assert "protection.mode" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "connected").exists()


@pytest.mark.integration
@pytest.mark.parametrize(("driver", "is_found"), [("real", True), ("simulated", False)])
def test_check_finds_a_real_robot_without_protection(
    tmp_path: Path, unprotected: tuple[str, ...], driver: str, is_found: bool
) -> None:
    done = with_drivers(tmp_path, *unprotected, driver, "--check")
    lines = [line for line in done.stdout.splitlines() if line.startswith("fault")]
    assert any("protection.mode" in line for line in lines) is is_found
    assert done.returncode == 1  # the simulated driver finds no world


@pytest.mark.integration
def test_3_if_the_id_is_held(tmp_path: Path) -> None:
    swarm = unique_swarm()
    with DaemonProcess(tmp_path / "a", swarm=swarm, robot="r1", endpoint="tcp/127.0.0.1:9") as one:
        one.wait_ready()
        done = with_drivers(tmp_path / "b", "--id", "r1", "--swarm", swarm)
        assert done.returncode == 3
        assert "'r1'" in done.stderr.splitlines()[-1]
        assert one.process.poll() is None


@pytest.mark.integration
@pytest.mark.skipif(
    os.geteuid() != 0 or not all(map(shutil.which, ("setpriv", "unshare", "ip"))),
    reason="needs root, setpriv, unshare and ip",
)
@pytest.mark.parametrize(("profile", "is_open"), [("dev", True), ("field", False)])
def test_processes_of_its_user_cannot_look_into_a_daemon_on_a_network(
    tmp_path: Path, profile: str, is_open: bool
) -> None:
    without_rights = ("setpriv", "--bounding-set=-all", "--inh-caps=-all", "--no-new-privs")
    lo_up = ("sh", "-c", 'ip link set lo up && exec "$@"', "sh")
    with DaemonProcess(
        tmp_path,
        swarm=unique_swarm(),
        robot="r1",
        endpoint="tcp/127.0.0.1:9",
        options={"profile": profile, "interface": "lo", "insecure": True},
        prefix=("unshare", "--net", *lo_up, *without_rights),
    ) as daemon:

        def is_readable() -> bool:
            command = [*without_rights, "cat", f"/proc/{daemon.process.pid}/environ"]
            return subprocess.run(command, capture_output=True, check=False).returncode == 0

        daemon.wait_ready()
        assert is_readable() is is_open


@pytest.mark.integration
def test_4_without_a_network(tmp_path: Path) -> None:
    done = with_drivers(
        tmp_path, "--id", "r1", "--profile", "field", "--interface", "wlan77", "--insecure"
    )
    assert done.returncode == 4
    assert "'wlan77'" in done.stderr.splitlines()[-1]


@pytest.mark.integration
def test_5_for_a_driver_that_cannot_be_used(tmp_path: Path) -> None:
    done = with_drivers(tmp_path, "--id", "r1", "--driver", "unusable")
    assert (done.returncode, done.stderr.count("\n")) == (5, 1)
    assert "/dev/ttyACM0" in done.stderr


def test_the_version_is_that_of_the_package() -> None:
    done = CliRunner().invoke(command, ["--version"])
    assert (done.exit_code, done.output) == (0, f"swarmd {version('swarmd')}\n")


@pytest.mark.integration
@pytest.mark.parametrize("program", ["swarmd", "swarmctl"])
def test_output_on_a_full_disk_is_one_line_and_exit_1(program: str) -> None:
    """Not 120, with which Python ends if it writes buffered output too late."""
    environ = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    with Path("/dev/full").open("wb") as full:
        ended = subprocess.run(
            [Path(sys.executable).with_name(program), "--help"],
            stdout=full,
            stderr=subprocess.PIPE,
            env=environ,
            text=True,
            timeout=CAP,
            check=False,
        )
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1), ended.stderr


AT_FORK = """
import os, sys
from swarmd.operator.cli.daemon import main

def show():
    named = {"argparse", "asyncio", "logging", "numpy", "zenoh"}
    print(*sorted(named & sys.modules.keys()), flush=True)
    os._exit(0)

os.register_at_fork(before=show)
main([])
"""


@pytest.mark.integration
def test_a_pattern_host_begins_without_what_the_daemon_alone_needs() -> None:
    done = subprocess.run(
        [sys.executable, "-c", AT_FORK], capture_output=True, text=True, timeout=CAP, check=False
    )
    assert (done.returncode, done.stdout) == (0, "numpy\n"), done.stderr


LOADED = """
import sys
import numpy as np
from swarmd.daemon.daemon import serve
from swarmd.robot.sensing.deskew import TimedRays
from swarmd.settings.platforms import load_platform

TimedRays(np.linspace(0.0, 6.0, 360), None, load_platform("burger").scan.sweep)
print(*sorted({"argparse", "numpy", "numpy.ma"} & sys.modules.keys()))
"""


@pytest.mark.integration
def test_a_daemon_holds_neither_argparse_nor_masked_arrays() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOADED], capture_output=True, text=True, timeout=CAP, check=False
    )
    assert (done.returncode, done.stdout) == (0, "numpy\n"), done.stderr
