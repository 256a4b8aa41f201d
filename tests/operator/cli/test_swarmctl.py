"""`swarmctl` as a user runs it, where no swarm is needed: what it loads, refuses and leaves."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import click
import pytest

from swarmd.core.errors import ConfigError, NetworkError, SwarmError
from swarmd.operator.cli.output import signals_end
from swarmd.operator.cli.plugin_check import describe_patterns
from swarmd.operator.cli.swarmctl import VERBS, cli, exit_code_of, main, run_cli
from tests.support.processes import unique_swarm
from tests.support.swarmctl import fork_command, swarmctl

LOADED = """
import json, sys
from swarmd.operator.cli.swarmctl import main
try:
    main(sys.argv[1:])
finally:
    print(json.dumps(sorted(sys.modules)), file=sys.stderr)
"""
OWN = '''
from swarmd.api import Inputs, MovementPattern, Params, Twist

class Own(MovementPattern[Params]):
    """Stands."""

    def drive(self, inputs: Inputs) -> Twist:
        return Twist()
'''
SHY = str(Path(__file__).parents[3] / "examples" / "shy.py")
SOON = ("--timeout", "200ms")
EXAMPLES = ("exp", "plugin", "record", "keys")
HEAVY = {"numpy", "rich", "yaml", "asyncio", "mujoco", "matplotlib", "swarmd.patterns"}
NOT_NEEDED = {"importlib.metadata", "logging", "swarmd.plugins"}
OF_KEYS = {"swarmd.link.signature"}  # a swarm without keys signs nothing


@pytest.fixture(autouse=True)
def no_context(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No context of the user who runs the tests is in use, such as `keys init` leaves."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


def loaded(*args: str) -> set[str]:
    """The modules that a command has loaded by its end."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED, *args],
        capture_output=True,
        text=True,
        env={**os.environ, "SWARM": unique_swarm()},
        timeout=60,
        check=False,
    )
    return set(json.loads(done.stderr.splitlines()[-1]))


@pytest.mark.integration
def test_help_loads_nothing_heavy_and_no_message() -> None:
    assert not loaded("--help") & (HEAVY | {"msgspec", "hashlib"})


@pytest.mark.integration
@pytest.mark.parametrize(
    "args", [["members"], ["run", "drive", "--all"], ["estop", "--timeout", "1s"]]
)
def test_a_verb_loads_nothing_heavy_and_reads_no_package_metadata(args: list[str]) -> None:
    assert not loaded(*args) & (HEAVY | NOT_NEEDED | OF_KEYS)


def test_help_of_a_verb_by_either_word() -> None:
    for words in (("stop",), ("record", "fetch"), ()):
        asked, wanted = swarmctl("help", *words), swarmctl(*words, "--help")
        assert (asked.code, asked.out, asked.err) == (0, wanted.out, "")


def test_every_verb_of_contexts_answers_in_json() -> None:
    given = [
        swarmctl("context", *words, "-o", "json").json
        for words in (
            ("add", "lab", "--swarm", "meadow"),
            ("use", "lab"),
            ("show",),
            ("remove", "lab"),
            ("list",),
        )
    ]
    assert [one["kind"] for one in given] == ["Context"] * 4 + ["Contexts"]
    assert [(one["name"], one["swarm"]) for one in given[:3]] == [("lab", "meadow")] * 3
    assert given[3]["was_in_use"] is True


def examples() -> dict[str, tuple[click.Command, list[str]]]:
    """The words of the example of each verb in these groups, and the verb."""
    groups = {name: cli.get_command(click.Context(cli), name) for name in EXAMPLES}
    return {
        f"{name} {verb}": (command, shlex.split((command.epilog or "").partition("swarmctl ")[2]))
        for name, group in groups.items()
        if isinstance(group, click.Group)
        for verb, command in group.commands.items()
    }


def test_the_example_of_each_verb_is_a_line_that_the_verb_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in (
        "mine",
        "evening",
        "runs/gather",
        "runs/first",
        "runs/spacing",
        "runs/rules",
        "runs/patrol",
    ):
        Path(folder).mkdir(parents=True)
    for file in ("mine/swirl.py", "shy.py", "survey.yaml", "alice.bundle"):
        Path(file).touch()
    given = examples()
    assert {name for name, (_, words) in given.items() if " ".join(words[:2]) != name} == set()
    assert len(given) == 39
    for name, (command, words) in given.items():
        command.make_context(name, words[2:])


@pytest.mark.integration
def test_help_lists_all_verbs(tmp_path: Path) -> None:
    done = fork_command("swarmctl", "--help", cwd=tmp_path)
    assert done.returncode == 0
    for verb in (*VERBS, "sim", "demo", "exp", "tour"):
        assert done.stdout.count(f"\n  {verb} ") == 1
    for section in {one.section for one in VERBS.values()}:
        assert done.stdout.count(f"\n{section}:\n") == 1
    assert "Comes with" not in done.stdout


def test_a_verb_names_the_options_of_the_network_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_cli(cli, ["stop", "--help"], "swarmctl", exit_code_of) == 0
    said = capsys.readouterr().out
    assert "--swarm, --config, --profile" in said
    assert "may be repeated" not in said
    assert "--timeout DURATION" in said


def test_every_verb_has_a_help() -> None:
    given = {verb: swarmctl(verb, "--help") for verb in VERBS}
    wrong = {
        verb: done
        for verb, done in given.items()
        if (done.code, done.err) != (0, "") or not done.out.startswith(f"Usage: swarmctl {verb} ")
    }
    assert wrong == {}


@pytest.mark.integration
def test_the_shell_completes_verbs_of_core_and_plugins(tmp_path: Path) -> None:
    words = {"COMP_WORDS": "swarmctl de", "COMP_CWORD": "1"}
    done = fork_command("swarmctl", cwd=tmp_path, _SWARMCTL_COMPLETE="bash_complete", **words)
    assert done.stdout.split() == ["plain,describe", "plain,demo"]


@pytest.mark.integration
@pytest.mark.parametrize(
    ("args", "subject"),
    [
        (["mebers"], "'members'"),
        (["dmo"], "'demo'"),
        (["--swrm", "x", "members"], "'--swarm'"),
        (["members", "-o", "xml"], "'-o'"),
        (["members", "forgt", "r1"], "'forget'"),
        (["patterns", "list", "--interface", "wlan0"], "--interface"),
        (["run"], "PATTERN"),
        (["run", "drive"], "run needs targets"),
        (["run", "../x", "--all"], "'../x'"),
        (["run", "drive", "r1", "--all"], "--all"),
        (["run", "drive", "**", "--for", "x"], "'x'"),
        (["run", "drive", "r1", "-p", "speed"], "-p 'speed'"),
        (["run", "drive", "r1", "--until", "near:1"], "'nearer'"),
        (["run", "drive", "R1"], "R1"),
        (["run", "drive", "--all", "-p", "speed=0", "-p", "speed=1"], "speed"),
        (["run", "drive", "--all", "--for", "0s"], "--for"),
        (["run", "drive", "--all", "--fro", "60s"], "--fro"),
        (["stop", "a/b"], "'a/b'"),
        (["reset"], "reset needs targets"),
        (["param", "set", "speed=1"], "param set needs targets"),
        (["param", "set", "r1"], "param set needs values"),
        (["patterns", "show", "driv"], "'drive'"),
        (["patterns", "show", "shy"], "--plugin-dir"),
        (["patterns", "show", "shy", "--plugin-dir", SHY], f"its folder, {Path(SHY).parent} "),
        (["demo", "--pattern", "shy"], "--plugin-dir"),
        (["demo", "--pattern", "shy", "--plugin-dir", SHY], f"its folder, {Path(SHY).parent} "),
        (["run", "drive", "--seconds", "5s"], "run needs targets"),
        (["demo", "--for", "5s", "-n", "0"], "'-n'"),
        (["patterns", "list", "--platform", "wafle_pi"], "'waffle_pi'"),
        (["--swarm", "A B", "members"], "'A B'"),
        (["--profile", "field", "members"], "`interface`"),
        (["--profile", "field", "--interface", "lo", "members"], "a name of its own"),
        (["--config", "none.yaml", "members"], "none.yaml"),
        (["--seed", "x", "members"], "'x'"),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_2(
    capsys: pytest.CaptureFixture[str], args: list[str], subject: str
) -> None:
    assert run_cli(cli, args, "swarmctl", exit_code_of) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert subject in captured.err
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1


@pytest.mark.parametrize(
    ("args", "code"),
    [
        (["members", "-o", "json", "--swrm"], 2),
        (["-o", "json", "mebers"], 2),
        (["run", "drive", "R1", "-ojson"], 2),
        (["keys", "list", "--swarm", "no_such", "--output=json"], 2),
        (
            [
                "--swarm",
                "lab",
                *["--profile", "field", "--interface", "wlan77", "members", "-o", "json"],
            ],
            6,
        ),
    ],
)
def test_an_error_is_one_document_in_json(
    capsys: pytest.CaptureFixture[str], args: list[str], code: int
) -> None:
    assert run_cli(cli, args, "swarmctl", exit_code_of) == code
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert (found["kind"], found["exit_code"]) == ("Error", code)
    assert captured.err == f"error: {found['error']}\n"


@pytest.mark.parametrize("words", ["estop --al", "estop --reason", "stop R1", "estop -l"])
def test_a_mistake_in_a_stop_says_first_that_no_robot_stops(
    capsys: pytest.CaptureFixture[str], words: str
) -> None:
    assert run_cli(cli, words.split(), "swarmctl", exit_code_of) == 2
    assert capsys.readouterr().err.startswith("error: nothing was sent and no robot stops: ")


@pytest.mark.integration
@pytest.mark.parametrize(
    "args",
    [
        ["members"],
        ["describe", "r1", *SOON],
        ["run", "drive", "--all", *SOON],
        ["stop", *SOON],
        ["estop", "r1", *SOON],
        ["reset", "--all", "--yes", *SOON],
        ["param", "set", "--all", "speed=1", *SOON],
    ],
)
def test_without_a_daemon_verbs_end_with_6_and_write_nothing(
    tmp_path: Path, args: list[str]
) -> None:
    swarm = unique_swarm()
    done = fork_command("swarmctl", *args, cwd=tmp_path, SWARM=swarm)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (6, "", 1), done
    assert f"'{swarm}'" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_network_interface_ends_with_6(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--swarm", "lab", "--profile", "field", "--interface", "wlan77", "members"]
    assert run_cli(cli, words, "swarmctl", exit_code_of) == 6
    assert "'wlan77'" in capsys.readouterr().err


@pytest.mark.integration
def test_the_swarm_is_that_of_the_file_given(tmp_path: Path) -> None:
    (tmp_path / "swarm.yaml").write_text("swarm: from-file")
    command = ("swarmctl", "members", *SOON)
    named = fork_command(*command, "--config", "swarm.yaml", cwd=tmp_path)
    assert "'from-file'" in named.stderr
    by_environment = fork_command(*command, cwd=tmp_path, SWARM_CONFIG="swarm.yaml")
    assert "'from-file'" in by_environment.stderr
    overridden = fork_command(*command, "--config", "swarm.yaml", "--swarm", "other", cwd=tmp_path)
    assert "'other'" in overridden.stderr


@pytest.mark.integration
def test_lists_patterns_with_their_needs(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("import nothing_of_that_name")
    done = fork_command(
        "swarmctl", "patterns", "list", "--plugin-dir", ".", "-o", "json", cwd=tmp_path
    )
    answer = json.loads(done.stdout)
    rows = {row["name"]: row for row in answer["patterns"]}
    assert (done.returncode, answer["apiVersion"]) == (0, "swarm/v1")
    assert rows["attraction"]["needs"] == ["scan"]
    assert "nothing_of_that_name" in rows["broken"]["error"]


@pytest.mark.integration
def test_the_list_of_patterns_is_whole_in_a_pipe(tmp_path: Path) -> None:
    lines = fork_command("swarmctl", "patterns", "list", cwd=tmp_path).stdout.splitlines()
    (line,) = (line for line in lines if line.startswith("foraging "))
    assert "reading:light_1, reading:light_2, scan  " in line  # the end of what it needs
    assert not [line for line in lines if "..." in line]


@pytest.mark.integration
def test_a_plugin_that_ends_its_process_is_named_and_others_are_shown(tmp_path: Path) -> None:
    (tmp_path / "able.py").write_text(OWN)
    (tmp_path / "ends.py").write_text("import os\nos._exit(3)")
    (tmp_path / "gives_up.py").write_text("raise SystemExit('not here')")
    (tmp_path / "hangs.py").write_text("import signal\nsignal.pause()")
    (tmp_path / "is_killed.py").write_text("import os\nos.kill(os.getpid(), 9)")
    (tmp_path / "talks.py").write_text("import os\nos.write(1, b'{}{')\n" + OWN)
    rows = {row["name"]: row for row in describe_patterns((), tmp_path, "burger", timeout=8.0)}
    errors = {name: row["error"] for name, row in rows.items() if "error" in row}
    assert errors == {
        "ends": "the process that imports it ended with code 3",
        "gives_up": "SystemExit: not here (gives_up.py:1)",
        "hangs": "the process that imports it is not done after 8 s (hangs.py:2)",
        "is_killed": "the process that imports it was killed by SIGKILL",
    }
    assert {"able", "attraction", "random_walk", "talks"} <= rows.keys()
    assert list(rows) == sorted(rows)
    assert rows["ends"]["source"] == str(tmp_path / "ends.py")


@pytest.mark.integration
def test_show_lists_parameters_with_their_bounds(tmp_path: Path) -> None:
    done = fork_command(
        "swarmctl", "patterns", "show", "drive", "--platform", "burger", cwd=tmp_path
    )
    speed = next(line for line in done.stdout.splitlines() if line.startswith("speed "))
    assert done.returncode == 0
    assert "0.22" in speed
    assert "a float from -2 to 2 m/s" in speed


@pytest.mark.integration
def test_a_verb_that_lacks_a_library_names_its_installation(tmp_path: Path) -> None:
    info = tmp_path / "outsider-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        'Name: outsider\nVersion: 1\nRequires-Dist: absent-core; extra == "far"\n'
    )
    (info / "entry_points.txt").write_text(
        "[swarmd.commands]\nearly = outsider_early:go\nlate = outsider_late:go\n"
    )
    (tmp_path / "outsider_early.py").write_text("import absent\n")
    (tmp_path / "outsider_late.py").write_text(
        "import click\n@click.command()\ndef go():\n    import absent.deep\n"
    )
    for verb in ("early", "late"):
        done = fork_command("swarmctl", verb, cwd=tmp_path, PYTHONPATH=str(tmp_path))
        assert done.returncode == 1
        assert "pip install 'outsider[far]'" in done.stderr
        assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ConfigError("x"), 2),
        (NetworkError("x"), 6),
        (SwarmError("x"), 1),
        (OSError(28, "No space left on device", "runs/x.png"), 1),
        (OSError("cannot write mode P"), 1),
        (KeyboardInterrupt(), 130),
    ],
)
def test_every_error_is_one_line_with_its_code(
    capsys: pytest.CaptureFixture[str], error: BaseException, code: int
) -> None:
    @click.command()
    def fail() -> None:
        raise error

    assert run_cli(fail, [], "swarmctl", exit_code_of) == code
    assert capsys.readouterr().err.count("\n") <= 2


@pytest.mark.integration
def test_a_closed_pipe_is_no_traceback(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-c",
        "from swarmd.operator.cli.swarmctl import main; main()",
        "--help",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(30) == 141


@pytest.mark.integration
@pytest.mark.parametrize("name", ["swarmctl", "swarmd"])
def test_ctrl_c_while_a_command_is_imported_is_no_traceback(tmp_path: Path, name: str) -> None:
    slow = "import signal\nprint('importing', flush=True)\nsignal.pause()\n"
    (tmp_path / "click.py").write_text(slow)
    with subprocess.Popen(
        [sys.executable, "-c", f"from swarmd.operator.cli.entry import {name}; {name}()"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == b"importing\n"
        process.send_signal(signal.SIGINT)
        assert process.stderr.read() == b"error: interrupted\n"
        assert process.wait(30) == 130


@pytest.mark.integration
def test_files_of_the_working_directory_are_not_imported(tmp_path: Path) -> None:
    for name in ("json", "random", "numpy", "swarmd"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('the wrong file')")
    command = [str(Path(sys.executable).with_name("swarmctl")), "patterns"]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "\nattraction " in done.stdout


@pytest.mark.parametrize("has_zenoh", [True, False])
def test_threads_of_zenoh_do_not_keep_the_process(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], has_zenoh: bool
) -> None:
    left: list[int] = []
    if has_zenoh:
        monkeypatch.setitem(sys.modules, "zenoh", sys)
    else:
        monkeypatch.delitem(sys.modules, "zenoh", raising=False)
    monkeypatch.setattr(os, "_exit", left.append)
    with pytest.raises(SystemExit) as ended:
        main(["mebers"])
    assert (left, ended.value.code) == ([2] if has_zenoh else [], 2)
    assert "'members'" in capsys.readouterr().err


def test_a_verb_that_sigterm_ends_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    @click.command()
    def waits() -> None:
        with signals_end():
            signal.raise_signal(signal.SIGTERM)

    assert run_cli(waits, [], "swarmctl", exit_code_of) == 143
    assert capsys.readouterr() == ("", "error: ended by SIGTERM\n")


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("can't start new thread")])
def test_a_process_without_memory_for_itself_ends_in_one_line(
    capsys: pytest.CaptureFixture[str], error: Exception
) -> None:
    @click.command()
    def limited() -> None:
        raise error

    assert run_cli(limited, [], "swarmd", lambda _: 2) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "ulimit -v" in line


def test_an_error_of_the_program_itself_keeps_its_traceback() -> None:
    @click.command()
    def broken() -> None:
        raise RuntimeError("on purpose")

    with pytest.raises(RuntimeError, match="on purpose"):
        run_cli(broken, [], "swarmd", lambda _: 2)


@pytest.mark.integration
def test_help_is_there_where_python_drops_docstrings() -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "from swarmd.operator.cli.entry import swarmctl; swarmctl()",
            "stop",
            "-h",
        ],
        env={**os.environ, "PYTHONOPTIMIZE": "2"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0
    assert "Stop " in done.stdout.partition("Options:")[0]
