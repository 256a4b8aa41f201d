"""`swarmd` as a command: settings, checks and exit codes, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from swarmd.cli.daemon import exit_code_of
from swarmd.cli.daemon import swarmd as command
from swarmd.cli.swarmctl import run_cli
from swarmd.settings.settings import load_daemon_settings, load_platform
from tests.support.fake_body import Body
from tests.support.processes import unique_swarm


def swarmd(*args: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "HOME": str(cwd), "SWARM": ""}
    return subprocess.run(
        [sys.executable, "-m", "swarmd.cli.daemon", *args],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=environment,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize(
    ("args", "subject"),
    [
        (["--platform", "wafle_pi"], "'waffle_pi'"),
        (["--id", "TB3"], "'TB3'"),
        (["--driver", "simulted"], "'simulated'"),
        (["--config", "none.yaml"], "none.yaml"),
        (["--config", "twice.yaml"], "twice.yaml:2: "),
        (["--config", "typo.yaml"], "'platform'"),
        (["--config", "range.yaml"], "range.yaml: lease"),
        (["--profile", "field"], "`interface`"),
        (["--profile", "feld"], "'feld'"),
        (["--driver-option", "x"], "--driver-option 'x'"),
        (["--chek"], "'--check'"),
        (["--driver-option", "endpont=x"], "endpont"),
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
    (tmp_path / "typo.yaml").write_text("id: a\nplattform: burger")
    (tmp_path / "range.yaml").write_text("id: a\nlease: 0")
    words = [*args, *([] if "--id" in args else ["--id", "r1"])]
    assert run_cli(command, words, "swarmd", exit_code_of) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert subject in captured.err
    assert captured.err.count("\n") == 1


def test_driver_options_are_read_as_in_a_file(tmp_path: Path) -> None:
    words = ("loop=true", "again=false", "speed=2", "namespace={robot}")
    given = [part for word in words for part in ("--driver-option", word)]
    done = swarmd("--id", "r1", *given, "--print-effective-config", cwd=tmp_path)
    found = yaml.safe_load(done.stdout)["driver_options"]
    assert {"loop": True, "again": False, "speed": 2, "namespace": "{robot}"}.items() <= (
        found.items()
    )


def test_the_effective_configuration_has_sources_and_reads_back_the_same(tmp_path: Path) -> None:
    (tmp_path / "swarm.yaml").write_text("swarm: lab\nroster: [r1, r2]\nlabels: {red: [r1]}")
    (tmp_path / "r.yaml").write_text(
        "swarm_file: swarm.yaml\nplatform: burger\ndriver_options: {endpoint: tcp/127.0.0.1:9}\n"
        "touch: {push: {half_width_deg: 20, speed: 0.1}, dock: null}"
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
    for key in (*same, "touch"):
        assert getattr(again, key) == getattr(first, key)


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
    found = {line[6:].split("  ")[0]: line[:4].strip() for line in done.stdout.splitlines()[:-1]}
    assert found["settings"] == found["platform"] == found["pattern drive"] == "ok"
    assert found["pattern broken"] == "FAIL"
    assert found["roster"] == "FAIL"
    assert "nothing_of_that_name" in done.stdout
    assert not (tmp_path / ".local").exists()


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
