"""`swarmctl demo` and `swarmctl sim up` as a user runs them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import pytest

from swarmd.core.errors import SwarmError
from swarmd.sim.cli.demo import finish, new_folder
from swarmd.sim.live.summary import Numbers, Summary
from tests.support.processes import unique_swarm, wait_until

SWARMCTL = str(Path(sys.executable).with_name("swarmctl"))
RAISES = '''
from swarmd.api import Inputs, MovementPattern, Params, Twist

class Clumsy(MovementPattern[Params]):
    """Fails after a while."""

    steps = 0

    def drive(self, inputs: Inputs) -> Twist:
        self.steps += 1
        if self.steps > 5:
            raise ValueError("stumbled")
        return Twist(linear=0.05)
'''


def swarmctl(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [SWARMCTL, *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)


def demo(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return swarmctl(folder, "demo", *words)


def members(swarm: str) -> str:
    command = [SWARMCTL, "--swarm", swarm, "members"]
    return subprocess.run(command, capture_output=True, text=True, timeout=30).stdout


def running_with(word: str) -> dict[int, str]:
    """The command lines of living processes in which a word occurs, oldest first."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = path.read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue
        if word in line:
            found[int(path.parent.name)] = line
    return dict(sorted(found.items()))


def test_each_run_has_a_folder_of_its_own(tmp_path: Path) -> None:
    folders = {new_folder(tmp_path / "runs") for _ in range(3)}
    assert len(folders) == 3
    assert all(folder.is_dir() for folder in folders)


@pytest.mark.integration
def test_demo_runs_to_the_end_and_leaves_its_results(tmp_path: Path) -> None:
    done = demo(tmp_path, "-n", "3", "--seconds", "4", "--platform", "burger", "-o", "json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["apiVersion"] == "swarm/v1"
    assert answer["problems"] == []
    assert answer["numbers"]["seconds"] == pytest.approx(4.0, abs=0.1)
    assert answer["numbers"]["contacts"] == 0
    assert answer["seconds_to_moving"] > 0.0
    folder = tmp_path / answer["folder"]
    assert json.loads((folder / "summary.json").read_text())["robots"] == answer["robots"]
    assert (folder / "trajectories.png").read_bytes().startswith(b"\x89PNG")
    print(f"all moving after {answer['seconds_to_moving']} s")


@pytest.mark.integration
def test_demo_without_a_terminal_prints_the_summary_alone(tmp_path: Path) -> None:
    done = demo(tmp_path, "-n", "2", "--seconds", "2")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Summary\n")
    assert "\x1b" not in done.stdout


@pytest.mark.integration
def test_demo_fails_if_a_pattern_fails(tmp_path: Path) -> None:
    (tmp_path / "clumsy.py").write_text(RAISES)
    words = ("-n", "2", "--seconds", "3", "--pattern", "clumsy", "--plugin-dir", str(tmp_path))
    done = demo(tmp_path, *words)
    assert done.returncode == 1
    assert "problem: tb3-01" in done.stderr
    assert "problem: tb3-02" in done.stderr


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--pattern", "atraction"], "did you mean 'attraction'?"),
        (["--platform", "waffle"], "no platform 'waffle'"),
        (["--arena", "1x1"], "no room for robot"),
        (["--layout", "circle"], "no layout 'circle'"),
        (["--seconds", "soon"], "no duration"),
        (["-p", "speed"], "no key=value"),
        (["-n", "0"], "0 is not in the range"),
        (["--emulate", "ros2dd"], "no dialect 'ros2dd'; did you mean 'ros2dds'?"),
        (["--emulate", "ros2dds", "--radio-range", "2"], "no robot says there whom it hears"),
        (["--seed", "-1"], "-1 is not in the range"),
        (["--platform", "own/My Bot.yaml"], "would be named 'My Bot-01', which is no robot id"),
        (["--platform", "own/a,b.yaml"], "'own/a,b.yaml': a comma or colon; rename"),
        (["--platform", "own/a:b.yaml"], "'own/a:b.yaml': a comma or colon; rename"),
        (["--platform", "own/c.yaml"], "own/c.yaml: cannot be read: No such file"),
    ],
)
def test_what_cannot_be_is_one_line_and_starts_nothing(
    tmp_path: Path, words: Sequence[str], line: str
) -> None:
    (tmp_path / "own").mkdir()
    for name in ("My Bot", "a,b", "a:b"):
        (tmp_path / "own" / f"{name}.yaml").write_text("extends: burger")
    done = demo(tmp_path, *words)
    assert done.returncode == 2
    assert line in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["own"]


@pytest.mark.parametrize("words", [["--seed", "-1"], ["--platform", "My Bot.yaml"]])
def test_sim_up_refuses_the_same(tmp_path: Path, words: Sequence[str]) -> None:
    (tmp_path / "My Bot.yaml").write_text("extends: burger")
    done = swarmctl(tmp_path, "sim", "up", *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1


def test_no_place_for_results_is_one_line_and_starts_nothing(tmp_path: Path) -> None:
    (tmp_path / "runs").touch()
    done = demo(tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: runs/")
    assert done.stderr.endswith(
        "/ cannot be made (Not a directory); call it in a folder that may be written to\n"
    )


def test_a_full_disk_does_not_cost_the_summary(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers = dict.fromkeys((field.name for field in fields(Numbers)), 1)
    summary = Summary(
        pattern="attraction",
        platform="burger",
        robots=("tb3-01",),
        arena="4x4",
        layout="grid",
        seed=0,
        seconds_to_moving=1.0,
        numbers=Numbers(**numbers),  # ones in every field
        duty={},
        problems=(),
    )
    (tmp_path / "summary.json").symlink_to("/dev/full")
    with pytest.raises(SwarmError, match=r"could be kept in /.*/: No space left on device"):
        finish(summary, tmp_path, is_json=False)
    assert capsys.readouterr().out.startswith("Summary\n")


@pytest.mark.integration
def test_a_demo_of_an_own_platform_in_this_folder(tmp_path: Path) -> None:
    (tmp_path / "my_bot.yaml").write_text("extends: burger")
    done = demo(tmp_path, "-n", "1", "--seconds", "1", "--platform", "my_bot.yaml")
    assert done.returncode == 0, done.stderr


@pytest.mark.integration
def test_a_parameter_that_cannot_be_is_refused(tmp_path: Path) -> None:
    done = demo(tmp_path, "-n", "2", "--seconds", "2", "-p", "sped=1")
    assert done.returncode == 2
    assert "did you mean 'speed'?" in done.stderr.splitlines()[-1]


@pytest.mark.integration
def test_sim_up_goes_on_when_a_daemon_is_killed_and_it_can_be_started_again(tmp_path: Path) -> None:
    swarm = unique_swarm()
    command = [SWARMCTL, "sim", "up", "-n", "2", "--swarm", swarm, "--keep", str(tmp_path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        config = str(tmp_path / "tb3-02.yaml")
        try:
            assert "2 robots are up" in process.stdout.readline()
            os.kill(next(iter(running_with(config))), signal.SIGKILL)
            assert process.stderr.readline().startswith("tb3-02 was killed by SIGKILL: ")
            wait_until(lambda: "1/2 alive" in members(swarm), "tb3-02 is listed as failed")
            again = [sys.executable, "-m", "swarmd.cli.daemon", "--config", config]
            with subprocess.Popen(again, stderr=subprocess.DEVNULL) as second:
                wait_until(lambda: "2/2 alive" in members(swarm), "tb3-02 is back")
                second.terminate()
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0


@pytest.mark.integration
def test_sim_up_serves_a_second_terminal_until_interrupted(tmp_path: Path) -> None:
    swarm = unique_swarm()
    command = [SWARMCTL, "sim", "up", "-n", "2", "--swarm", swarm]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stdout is not None
        try:
            assert "2 robots are up" in process.stdout.readline()
            run = [SWARMCTL, "--swarm", swarm, "run", "dispersion", "--all"]
            told = subprocess.run(run, capture_output=True, text=True, timeout=30)
            again = subprocess.run(command, capture_output=True, text=True, timeout=30)
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    assert told.returncode == 0, told.stdout + told.stderr
    assert "2 targeted, 2 applied" in told.stdout
    assert again.returncode == 2
    assert f"swarm '{swarm}' already has tb3-01, tb3-02" in again.stderr
    assert running_with(swarm) == {}
