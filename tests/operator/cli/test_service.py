"""`swarmd service`: the unit in a root of its own, and what systemd's tools find in it."""

from __future__ import annotations

import json
import os
import re
import shutil
import stat
import subprocess
from pathlib import Path

import pytest

from swarmd.core.clock import TICK
from swarmd.daemon.daemon import NEIGHBORS_PERIOD
from swarmd.daemon.systemd import CONFIG_FILE, STATE_FOLDER, SYSUSERS_FILE, UNIT_FILE, unit_text
from swarmd.operator.cli.daemon import exit_code_of
from swarmd.operator.cli.daemon import swarmd as command
from swarmd.operator.cli.swarmctl import run_cli
from tests.support.unit_sandbox import settings_of

MAX_EXPOSURE = 3.0
PROGRAM = Path("/opt/swarmd/bin/swarmd")

needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed"
)
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")


def service(*words: str) -> int:
    return run_cli(command, ["service", *words], "swarmd", exit_code_of)


def within(root: Path, path: Path) -> Path:
    return root / path.relative_to("/")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """The root of a robot with swarmd, its settings and an identity."""
    found = tmp_path / "root"
    for path, text in (
        (PROGRAM, ""),
        (CONFIG_FILE, "id: r1\nswarm: meadow\n"),
        (CONFIG_FILE.parent / "identities/meadow/key.pem", "secret"),
        (STATE_FOLDER / "meadow/r1/latches", "x"),
        (Path("/etc/passwd"), "root:x:0:0::/root:/bin/sh\nswarmd:x:4321:1234::/:/bin/false\n"),
        (Path("/etc/group"), "root:x:0:\nswarmd:x:1234:\ndialout:x:20:\n"),
    ):
        within(found, path).parent.mkdir(parents=True, exist_ok=True)
        within(found, path).write_text(text)
    within(found, CONFIG_FILE).chmod(0o600)
    return found


@pytest.mark.integration
def test_install_and_uninstall_in_another_root(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert service("install", "--root", str(root)) == 0
    text = within(root, UNIT_FILE).read_text()
    assert text == unit_text(PROGRAM)
    assert "m swarmd dialout" in within(root, SYSUSERS_FILE).read_text()
    said = capsys.readouterr().out
    assert str(within(root, UNIT_FILE)) in said
    assert service("uninstall", "--root", str(root)) == 0
    assert not within(root, UNIT_FILE).exists()
    assert not within(root, SYSUSERS_FILE).exists()
    assert within(root, CONFIG_FILE).exists()
    assert within(root, STATE_FOLDER).exists()
    assert service("uninstall", "--root", str(root), "--purge") == 0
    assert not within(root, CONFIG_FILE.parent).exists()
    assert not within(root, STATE_FOLDER).exists()


@pytest.mark.integration
@needs_systemd
def test_the_service_is_enabled_without_a_running_systemd(root: Path) -> None:
    link = within(root, Path("/etc/systemd/system/multi-user.target.wants/swarmd.service"))
    assert service("install", "--root", str(root)) == 0
    assert link.is_symlink()
    assert service("uninstall", "--root", str(root)) == 0
    assert not link.is_symlink()


@pytest.mark.integration
@needs_root
def test_the_account_may_read_the_settings_and_use_the_identities(root: Path) -> None:
    outside = root / "outside"
    outside.write_text("")
    link = within(root, CONFIG_FILE.parent) / "identities/link"
    link.symlink_to(outside)
    assert service("install", "--root", str(root)) == 0
    config = within(root, CONFIG_FILE).stat()
    assert (config.st_uid, config.st_gid, stat.S_IMODE(config.st_mode)) == (0, 1234, 0o640)
    key = within(root, CONFIG_FILE.parent / "identities/meadow/key.pem").stat()
    assert (key.st_uid, key.st_gid) == (4321, 1234)
    assert outside.stat().st_uid == 0, "a link does not lead out"


def test_a_dry_run_changes_nothing(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(root.rglob("*"))
    assert service("install", "--root", str(root), "--dry-run") == 0
    assert service("uninstall", "--root", str(root), "--dry-run", "--purge") == 0
    assert sorted(root.rglob("*")) == before
    assert within(root, CONFIG_FILE).exists()
    assert f"would write {within(root, UNIT_FILE)}" in capsys.readouterr().out


@pytest.mark.integration
def test_without_the_tools_of_systemd_it_writes_and_names_what_is_left(
    root: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(root))
    assert service("install", "--root", str(root)) == 0
    said = capsys.readouterr().out
    assert "systemctl enable swarmd" in said
    assert "useradd" in said
    assert within(root, UNIT_FILE).exists()


def test_a_program_that_is_absent_is_refused(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    within(root, PROGRAM).unlink()
    assert service("install", "--root", str(root)) == 2
    assert "--program" in capsys.readouterr().err
    assert not within(root, UNIT_FILE).exists()


@pytest.mark.parametrize(
    "folder", ["o'neil", 'a"b', "back\\slash", "tab\tx", "new\nline", "bell\x07", "no\udcffutf8"]
)
def test_a_program_that_systemd_never_starts_is_refused_before_anything_is_written(
    folder: str, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """systemd.exec refuses quotes, backslashes and control characters in the name of a program."""
    program = Path("/home") / folder / "swarmd"
    within(root, program).parent.mkdir(parents=True)
    within(root, program).write_text("")
    assert service("install", "--root", str(root), "--program", str(program)) == 2
    told = capsys.readouterr()
    assert (told.out, told.err.count("\n")) == ("", 1)
    assert repr(str(program)) in told.err
    assert not within(root, UNIT_FILE).exists()
    assert not within(root, SYSUSERS_FILE).exists()


@pytest.mark.parametrize(
    ("path", "word"),
    [
        ("/opt/swarmd/bin/swarmd", "/opt/swarmd/bin/swarmd"),
        ("/home/my user/swarmd", '"/home/my user/swarmd"'),
        ("/home/100%/swarmd", '"/home/100%%/swarmd"'),
        ("/home/%h/swarmd", '"/home/%%h/swarmd"'),
        ("/home/x$HOME/swarmd", '"/home/x$HOME/swarmd"'),
        ("/home/a ; b/swarmd", '"/home/a ; b/swarmd"'),
        ("/home/ümlaut/swarmd", '"/home/ümlaut/swarmd"'),
    ],
)
def test_a_path_is_one_word_of_the_unit(path: str, word: str) -> None:
    unit = settings_of(unit_text(Path(path)))
    assert unit["ExecStart"] == [f"{word} --config {CONFIG_FILE}"]
    assert unit["ExecStopPost"] == [f"-{word} stop-base --config {CONFIG_FILE}"]


@pytest.mark.parametrize(
    ("path", "word"),
    [
        ("/etc/my swarm.yaml", '"/etc/my swarm.yaml"'),
        ("/etc/100%.yaml", '"/etc/100%%.yaml"'),
        ("/etc/$A.yaml", '"/etc/$$A.yaml"'),
        ("/etc/o'neil.yaml", '"/etc/o\'neil.yaml"'),
        ('/etc/a"b\\c.yaml', '"/etc/a\\"b\\\\c.yaml"'),
        ("/etc/tab\tx.yaml", '"/etc/tab\\x09x.yaml"'),
    ],
)
def test_the_path_of_the_settings_is_one_word_of_the_unit(path: str, word: str) -> None:
    unit = settings_of(unit_text(PROGRAM, Path(path)))
    assert unit["ExecStart"] == [f"{PROGRAM} --config {word}"]


@pytest.mark.integration
def test_the_status_names_what_is_there_and_what_is_wrong(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert service("status", "--root", str(root)) == 3
    assert "identity.json" in capsys.readouterr().out  # an identity without all its files
    (within(root, CONFIG_FILE).parent / "identities/meadow/key.pem").unlink()
    assert service("status", "--root", str(root)) == 3
    said = capsys.readouterr().out
    assert "absent" in said
    assert "r1 of swarm meadow" in said
    assert service("install", "--root", str(root)) == 0
    within(root, CONFIG_FILE).write_text("id: r1\nplatfrom: burger\n")
    capsys.readouterr()
    assert service("status", "--root", str(root)) == 3
    said = capsys.readouterr().out
    assert str(within(root, UNIT_FILE)) in said
    assert "'platform'" in said
    assert service("status", "--root", str(root), "-o", "json") == 3
    found = json.loads(capsys.readouterr().out)
    assert (found["unit"], found["is_active"]) == (str(within(root, UNIT_FILE)), False)


def test_the_daemon_feeds_the_watchdog_more_often_than_it_must() -> None:
    (seconds,) = settings_of(unit_text(PROGRAM))["WatchdogSec"]
    assert float(seconds) >= 4 * NEIGHBORS_PERIOD * TICK


def test_the_bridge_of_a_robot_stops_after_the_daemon_and_never_before() -> None:
    """The name is that of the unit in the packages of the bridge's makers."""
    unit = settings_of(unit_text(PROGRAM))
    assert "zenoh-bridge-ros2dds.service" in unit["After"][0].split()
    assert unit["StopPropagatedFrom"] == ["zenoh-bridge-ros2dds.service"]


@pytest.mark.integration
@needs_systemd
def test_systemd_finds_no_fault_in_the_unit_and_little_exposure(tmp_path: Path) -> None:
    unit = tmp_path / "swarmd.service"
    unit.write_text(unit_text(Path("/bin/true")))
    found = analyze("verify", str(unit))
    assert (found.returncode, found.stdout, found.stderr) == (0, "", "")
    found = analyze("security", "--offline=yes", f"--threshold={MAX_EXPOSURE * 10:.0f}", str(unit))
    assert found.returncode == 0, found.stdout
    exposure = re.search(r"exposure level for \S+: ([\d.]+)", found.stdout)
    assert exposure is not None
    assert float(exposure[1]) <= MAX_EXPOSURE


@pytest.mark.integration
@needs_systemd
@pytest.mark.parametrize("folder", ["a folder %h", "x$HOME ; ${HOME}", "-ümlaut @at #1 [2]*"])
def test_systemd_reads_paths_with_odd_characters(tmp_path: Path, folder: str) -> None:
    program = tmp_path / folder / "swarmd"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    unit = tmp_path / "swarmd.service"
    unit.write_text(unit_text(program))
    found = analyze("verify", str(unit))
    assert (found.returncode, found.stderr) == (0, "")
    program.unlink()
    assert analyze("verify", str(unit)).returncode != 0, "it looks for the program"


def analyze(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["systemd-analyze", *words], capture_output=True, text=True, timeout=30, check=False
    )
