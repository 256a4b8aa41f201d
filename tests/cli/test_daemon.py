"""`swarmd` as a command: settings, checks and exit codes, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from swarmd.settings.settings import load_daemon_settings, load_platform
from tests.support.fake_body import Body
from tests.support.processes import unique_swarm

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


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


def test_help_documents_every_exit_code(tmp_path: Path) -> None:
    done = swarmd("--help", cwd=tmp_path)
    assert done.returncode == 0
    for code in range(6):
        assert f"\n    {code}  " in done.stdout
    assert "--die-with-parent" not in done.stdout


@pytest.mark.parametrize(
    ("args", "fault"),
    [
        (["--platform", "wafle_pi"], "no platform 'wafle_pi'; did you mean 'waffle_pi'?"),
        (["--id", "TB3"], "--id: id is 'TB3'; wanted are 1 to 63"),
        (["--driver", "simulted"], "no driver 'simulted'; did you mean 'simulated'?"),
        (["--config", "none.yaml"], "none.yaml: cannot be read: No such file"),
        (["--config", "twice.yaml"], "twice.yaml:2: key 'id' stands twice, first in line 1"),
        (["--config", "typo.yaml"], "typo.yaml: no key 'plattform'; did you mean 'platform'?"),
        (["--config", "range.yaml"], "range.yaml: lease is 0; wanted a number of at least 0.2"),
        (["--profile", "field"], "--profile: profile field needs `interface`"),
        (["--profile", "feld"], "Invalid value for '--profile': 'feld' is not one of"),
        (["--driver-option", "x"], "--driver-option 'x' is no key=value"),
        (["--chek"], "No such option '--chek'. (Did you mean one of: '--check'"),
        (["--driver-option", "endpont=x"], "endpont"),
    ],
)
def test_a_mistake_is_one_line_and_exit_2(tmp_path: Path, args: list[str], fault: str) -> None:
    (tmp_path / "twice.yaml").write_text("id: a\nid: b")
    (tmp_path / "typo.yaml").write_text("id: a\nplattform: burger")
    (tmp_path / "range.yaml").write_text("id: a\nlease: 0")
    done = swarmd(*args, *([] if "--id" in args else ["--id", "r1"]), cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("error: ")
    assert fault in done.stderr
    assert done.stderr.count("\n") == 1


def test_driver_options_are_read_as_in_a_file(tmp_path: Path) -> None:
    words = ("loop=true", "again=false", "speed=2", "namespace={robot}")
    given = [part for word in words for part in ("--driver-option", word)]
    done = swarmd("--id", "r1", *given, "--print-effective-config", cwd=tmp_path)
    found = yaml.safe_load(done.stdout)["driver_options"]
    assert {"loop": True, "again": False, "speed": 2, "namespace": "{robot}"}.items() <= (
        found.items()
    )


def test_the_effective_configuration_names_sources_and_reads_back_the_same(tmp_path: Path) -> None:
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


def test_check_looks_at_everything_and_moves_nothing(tmp_path: Path) -> None:
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
    assert "No module named 'nothing_of_that_name'" in done.stdout
    assert "not well" in done.stdout.splitlines()[-1]
    assert not (tmp_path / ".local").exists()


def test_check_tells_of_what_may_be_touched_and_whether_that_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text(
        f"id: r1\nplugin_dir: {EXAMPLES}\ndriver_options: {{endpoint: tcp/127.0.0.1:9}}\n"
        "touch: {push: {half_width_deg: 10, speed: 0.1}, pusch: {half_width_deg: 9, speed: 0.1}}"
    )
    done = swarmd("--config", "r.yaml", "--check", cwd=tmp_path)
    granted, unknown = (line for line in done.stdout.splitlines() if line[6:].startswith("touch"))
    assert granted.startswith("ok")
    assert "push: granted +-10 deg ahead at up to 0.10 m/s; it asks for +-20 deg" in granted
    assert unknown.startswith("FAIL")
    assert "no pattern 'pusch'; did you mean 'push'?" in unknown


def test_check_tries_to_write_where_latches_are_kept(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for folder in ("/proc/x", "file/state"):
        done = swarmd("--id", "r1", "--state-dir", folder, "--check", cwd=tmp_path)
        (line,) = (line for line in done.stdout.splitlines() if "state_dir" in line)
        assert done.returncode == 1
        assert line.startswith("FAIL")
        assert f" {folder} cannot be written to (" in line
    done = swarmd("--id", "r1", "--state-dir", "a/b", "--check", cwd=tmp_path)
    assert "ok    state_dir" in done.stdout
    assert not (tmp_path / "a").exists()


def test_check_finds_parameters_that_no_pattern_takes(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text(
        "id: r1\nlabels: {red: [r1]}\nparameters:\n"
        "  labels: {red: {drve: {linear: 0.1}}}\n"
        "  robots: {r1: {drive: {sped: 0.1, speed: 1000}}}\n"
    )
    done = swarmd("--config", "r.yaml", "--check", cwd=tmp_path)
    assert "no pattern 'drve'; did you mean 'drive'?" in done.stdout
    assert "robot: drive: no parameter 'sped'; did you mean 'speed'?" in done.stdout
    assert "robot: drive: speed is 1000; wanted a float" in done.stdout


def test_check_checks_missions_as_a_whole_for_this_platform(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(
        "mission: Distances for TurtleBots\n"
        "parts: {vote: {pattern: majority_rule}, move: {pattern: dispersion}}\n"
        "map: [{from: vote.opinion, to: move.distance, values: [0.6, 1.3, 1.4]}]\n"
        "parallel: [vote, move]\ndrives: move\n"
    )
    args = ["--id", "r1", "--plugin-dir", ".", "--check"]
    found = {
        platform: swarmd(*args, "--platform", platform, cwd=tmp_path).stdout.splitlines()
        for platform in ("burger", "jackal")
    }
    (well,) = (line for line in found["burger"] if "pattern own" in line)
    (bad,) = (line for line in found["jackal"] if "pattern own" in line)
    assert well.startswith("ok  ")
    assert bad.startswith("FAIL")
    assert "own.yaml:3: map[0] sets move.distance to 0.6 where vote.opinion is 0" in bad
    (shipped,) = (line for line in found["jackal"] if "discuss_then_disperse" in line)
    assert shipped.startswith("ok  ")
    assert "not for this platform: " in shipped


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
        assert done.stdout.splitlines()[-1].endswith("checked, all well")
        assert all(command.twist.is_zero for command in body.commands)
