"""`swarmctl demo` and `swarmctl sim up` as a user runs them."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import pytest

from swarmd.core.errors import SwarmError
from swarmd.core.messages import Presence, Reason, State
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.operator.view.scene import Area, Scene
from swarmd.sim.cli.demo import progress_lines, report
from swarmd.sim.live.summary import METRICS, DemoSummary
from tests.sim.conftest import Refusal
from tests.support.processes import CAP, run_command, unique_swarm, wait_until
from tests.support.statuses import status
from tests.support.swarmctl import swarmctl_in_time

SWARMCTL = str(Path(sys.executable).with_name("swarmctl"))
RAISES = '''
from swarmd.api import Inputs, MovementPattern, Params, Twist

class Clumsy(MovementPattern[Params]):
    """Fails at once, again and again."""

    def drive(self, inputs: Inputs) -> Twist:
        raise ValueError("stumbled")
'''


def demo(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return run_command("swarmctl", "demo", *words, cwd=folder)


def named(name: str, folder: Path) -> list[int]:
    """The living processes of this name whose log lies in a folder; of any name, if it is empty."""
    found = []
    for path in Path("/proc").glob("[0-9]*/comm"):
        try:
            comm, log = path.read_text().strip(), (path.parent / "fd" / "2").readlink()
        except OSError:
            continue
        if log.parent == folder and name in ("", comm):
            found.append(int(path.parent.name))
    return found


@pytest.mark.integration
def test_a_pattern_that_fails_is_a_problem_in_a_plain_summary(tmp_path: Path) -> None:
    (tmp_path / "clumsy.py").write_text(RAISES)
    words = ("-n", "2", "--for", "4", "--pattern", "clumsy", "--plugin-dir", str(tmp_path))
    done = demo(tmp_path, *words)
    assert done.returncode == 1
    assert done.stdout.startswith("Summary\n")
    assert "\x1b" not in done.stdout
    assert "problem: tb3-01" in done.stderr
    assert "problem: tb3-02" in done.stderr
    # A loaded machine may take seconds from the recording's start to the first line.
    assert re.search(r"^clumsy, 2 waffle_pi: [0-4] of 4 s, ", done.stderr, re.MULTILINE)
    assert "\x1b" not in done.stderr


@pytest.mark.integration
@pytest.mark.parametrize(
    ("words", "subject"),
    [
        (["demo", "--pattern", "atraction"], "'attraction'"),
        (["demo", "--platform", "waffle"], "'waffle'"),
        (["demo", "--arena", "1x1"], "robot"),
        (["demo", "--layout", "circle"], "'circle'"),
        (["demo", "--layout", "list"], "0 poses; expected 7 of x:y:degrees, such as list:0:0:90"),
        (["demo", "--seconds", "soon"], "'soon'"),
        (["demo", "-p", "speed"], "'speed'"),
        (["demo", "-p", "sped=1"], "no parameter 'sped'"),
        (["demo", "-p", "speed=99"], "speed is 99"),
        (["demo", "-n", "0"], "0"),
        (["demo", "--emulate", "ros2dd"], "'ros2dds'"),
        (["demo", "--emulate", "ros2dds", "--radio-range", "2"], "--radio-range"),
        (["demo", "--seed", "-1"], "-1"),
        (["demo", "--platform", "own/My Bot.yaml"], "'My Bot-01'"),
        (["demo", "--platform", "own/a,b.yaml"], "'own/a,b.yaml'"),
        (["demo", "--platform", "own/a:b.yaml"], "'own/a:b.yaml'"),
        (["demo", "--platform", "own/c.yaml"], "own/c.yaml"),
        (["demo"], "error: runs/"),  # no place for results
        (["sim", "up", "--seed", "-1"], "-1"),
        (["sim", "up", "--platform", "own/My Bot.yaml"], "'My Bot-01'"),
    ],
)
def test_a_wrong_option_is_one_line_and_starts_nothing(
    tmp_path: Path, refusal: Refusal, words: Sequence[str], subject: str
) -> None:
    (tmp_path / "runs").touch()
    (tmp_path / "own").mkdir()
    for name in ("My Bot", "a,b", "a:b"):
        (tmp_path / "own" / f"{name}.yaml").write_text("extends: burger")
    assert subject in refusal(*words)


@pytest.fixture
def summary() -> DemoSummary:
    return DemoSummary(
        pattern="attraction",
        platform="burger",
        robots=("tb3-01",),
        arena="4x4",
        layout="grid",
        seed=0,
        seconds_to_moving=1.0,
        kernels="compiled",
        seconds=1.0,
        real_time_factor=1.0,
        metrics=dict.fromkeys(METRICS, 1.0),
        problems=(),
    )


def test_without_a_screen_a_demo_tells_its_states_every_five_seconds(
    capsys: pytest.CaptureFixture[str],
) -> None:
    now = iter((10.0, 14.9, 15.0, 19.0))
    tell = progress_lines(lambda: next(now))
    names = ("r1", "r2", "r3", "r4", "r5")
    statuses = {"r1": status("r1"), "r2": status("r2", state=State.ESTOPPED)}
    statuses["r4"] = status("r4", reason=Reason.NO_REQUESTED_COMMAND)
    statuses["r5"] = status("r5", reason=Reason.STALE_SCAN)
    for number in range(4):
        poses = dict.fromkeys(names, (0.0, 0.0, 0.0))
        tell(Scene(f"drive: {number} of 60 s\x1b[2J", Area((1.0, 1.0)), poses, statuses))
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [
        "drive: 0 of 60 s?[2J; 1 at rest, 1 estopped, 1 held, 1 running, 1 silent",
        "drive: 2 of 60 s?[2J; 1 at rest, 1 estopped, 1 held, 1 running, 1 silent",
    ]


@pytest.mark.evidence
@pytest.mark.integration
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_demo_in_a_pipe_ends_with_its_summary_and_folder(
    tmp_path: Path, number: signal.Signals
) -> None:
    command = [SWARMCTL, "demo", "-n", "2"]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, stdout=pipe, stderr=pipe, text=True, cwd=tmp_path, start_new_session=True
    ) as process:
        assert process.stderr is not None
        lines = iter(process.stderr.readline, "")
        running = next(line for line in lines if line.endswith("; 2 running\n"))
        os.killpg(process.pid, number)
        out, errors = process.communicate(timeout=CAP)
    # On a loaded machine the first lines may have a robot that is silent.
    assert re.match(r"attraction, 2 waffle_pi: \d+ of 60 s, ", running)
    assert process.returncode == 128 + number
    (folder,) = (tmp_path / "runs").iterdir()
    assert out.startswith("Summary\n")
    assert f"  results               runs/{folder.name}/" in out.splitlines()
    assert f"problem: {number.name} ended the run early\n" in errors
    assert (folder / "trace.npz").exists()
    assert "\x1b" not in out + errors


def test_a_full_disk_does_not_cost_the_summary(
    tmp_path: Path, summary: DemoSummary, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "summary.json").symlink_to("/dev/full")
    with pytest.raises(SwarmError, match="No space left on device"):
        report(summary, tmp_path, is_json=False)
    assert capsys.readouterr().out.startswith("Summary\n")


def test_a_reader_that_has_gone_does_not_cost_the_files(
    tmp_path: Path, summary: DemoSummary, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("swarmd.sim.cli.demo.print_section", fail)
    monkeypatch.setattr("swarmd.sim.cli.options.find_spec", lambda name: None)
    with pytest.raises(BrokenPipeError):
        report(summary, tmp_path, is_json=False)
    assert (tmp_path / "summary.json").exists()


def test_without_matplotlib_only_the_picture_is_missing(
    tmp_path: Path,
    summary: DemoSummary,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("swarmd.sim.cli.options.find_spec", lambda name: None)
    report(summary, tmp_path, is_json=False)
    captured = capsys.readouterr()
    assert captured.out.startswith("Summary\n")
    assert "pip install 'swarmd[sim,plot]'" in captured.err
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]


@pytest.mark.evidence
@pytest.mark.integration
@pytest.mark.parametrize("wait", [0.25 * count for count in range(1, 13)])
def test_ctrl_c_at_the_start_of_a_demo_is_one_line(tmp_path: Path, wait: float) -> None:
    """At whatever instant: no cap depends on how far the demo is after `wait` s."""
    command = [SWARMCTL, "demo", "-n", "3", "--headless"]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, stdout=pipe, stderr=pipe, text=True, cwd=tmp_path, start_new_session=True
    ) as process:
        time.sleep(wait)
        os.killpg(process.pid, signal.SIGINT)
        out, errors = process.communicate(timeout=CAP)
    told = [
        line for line in errors.splitlines() if line and not line.startswith("Starting a world")
    ]
    kept = [line for line in told if line.startswith("what was kept is in runs/")]
    if out:  # robots were running
        assert out.startswith("Summary\n")
        assert any(line.startswith("problem: SIGINT ended") for line in told)
    else:
        assert told == [*kept, "error: interrupted"]
    assert process.returncode == 130
    logs = [path / "logs" for path in (tmp_path / "runs").glob("*")]
    wait_until(lambda: not any(named("", one) for one in logs), "no process is left")
    wait_until(lambda: not children_of_session(process.pid), "no process of the group is left")


def children_of_session(session: int) -> list[int]:
    """The living processes of a session."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            if fields[0] != "Z" and int(fields[3]) == session:
                found.append(int(path.parent.name))
    return found


@pytest.mark.integration
def test_sim_up_of_a_swarm_whose_keys_are_here_prints_commands_that_reach_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    swarm = unique_swarm()
    monkeypatch.setenv("HOME", str(tmp_path))
    made = run_command(
        "swarmctl", "keys", "init", swarm, "--robots", "tb3-01", "--interface", "lo", cwd=tmp_path
    )
    assert made.returncode == 0, made.stderr  # the context has profile field from now on
    command = [SWARMCTL, "sim", "up", "-n", "1", "--swarm", swarm]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        try:
            assert "1 robot up" in process.stdout.readline()
            lines = [process.stdout.readline() for _ in range(2)]
            environment, _, *words = lines[1].split()[:-5]
            answered = run_command("swarmctl", *words, "--swarm", swarm, cwd=tmp_path)
        finally:
            process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=CAP)
    assert (environment, answered.returncode) == (f"SWARM={swarm}", 0), answered.stderr
    assert "tb3-01" in answered.stdout
    assert "no keys" in errors
    assert process.returncode == 0


@pytest.mark.integration
def test_sim_up_outlives_a_killed_daemon_and_ends_on_ctrl_c(tmp_path: Path) -> None:
    swarm = unique_swarm()
    command = [SWARMCTL, "sim", "up", "-n", "2", "--swarm", swarm, "--keep", str(tmp_path)]
    pipe = subprocess.PIPE
    with (
        Operator(NetworkSettings(swarm=swarm)) as operator,
        subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process,
    ):

        def count_alive() -> int:
            seen = operator.members().members.values()
            return sum(one.presence is Presence.ALIVE for one in seen)

        assert process.stdout is not None
        assert process.stderr is not None
        config = str(tmp_path / "tb3-02.yaml")
        try:
            assert "2 robots up" in process.stdout.readline()
            run = swarmctl_in_time("run", "dispersion", "--all", environ={"SWARM": swarm})
            again = run_command("swarmctl", "sim", "up", "-n", "2", cwd=tmp_path, SWARM=swarm)
            # A process that it forks has its name for a moment.
            name = f"tb3-02@{swarm}"[:15]  # the kernel keeps 15 characters
            wait_until(lambda: len(named(name, tmp_path)) == 1, "tb3-02 is there")
            (daemon,) = named(name, tmp_path)
            os.kill(daemon, signal.SIGKILL)
            assert process.stderr.readline().startswith("tb3-02 was killed by SIGKILL (log: ")
            wait_until(lambda: count_alive() == 1, "tb3-02 is listed as failed")
            restart = [sys.executable, "-m", "swarmd.operator.cli.daemon", "--config", config]
            with subprocess.Popen(restart, stderr=subprocess.DEVNULL) as second:
                wait_until(lambda: count_alive() == 2, "tb3-02 is back")
                second.terminate()
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(CAP) == 0
    assert run.outcome == (0, "2 targeted, 2 applied"), run
    assert again.returncode == 2
    assert f"swarm '{swarm}' already has tb3-01, tb3-02" in again.stderr
    wait_until(lambda: named("", tmp_path) == [], "no process is left")
