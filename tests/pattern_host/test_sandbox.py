"""What the code of a hostile pattern can reach from its host, with and without the sandbox."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import pytest

from swarmd.core.host_messages import (
    HostCommand,
    HostEvent,
    Load,
    Loaded,
    LoadRefused,
    StartTrial,
    Step,
    Stepped,
    TrialDone,
)
from swarmd.core.messages import Sandbox
from swarmd.core.values import Inputs
from swarmd.operator.cli.plugin_check import describe_patterns
from swarmd.pattern_host.runner import ProcessRunner
from swarmd.pattern_host.sandbox import FILES, NETWORK, PROCESSES
from swarmd.settings.settings import load_platform
from tests.pattern_host import sandbox_probes
from tests.support.processes import has_landlock

pytestmark = pytest.mark.integration

PLUGIN = """
from swarmd.api import Outputs, Params, Pattern

class Hostile(Pattern[Params]):
    needs = frozenset()
    def step(self, inputs):
        return Outputs(report=results(PLACE, os.getppid(), ["may", "reach", "break_out"]))
"""


@dataclass(frozen=True, slots=True)
class Place:
    """A robot's key, state folder and device, a port that listens, a home, and its plugins."""

    plugins: Path
    state: Path
    key: Path
    port: int
    serial: str
    home: Path

    def __str__(self) -> str:
        return json.dumps(asdict(self), default=str)


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    for folder in ("plugins", "state", "plugins/keys", "home"):
        (tmp_path / folder).mkdir()
    key = tmp_path / "plugins/keys/key.pem"  # below a folder that the pattern may read
    key.write_text("secret")
    key.chmod(0o600)
    (tmp_path / "state/latches").write_text("latched")
    (tmp_path / "plugins/other").write_text("other")
    (tmp_path / "home/diary").write_text("private")
    ends = os.openpty()
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield Place(
            tmp_path / "plugins",
            tmp_path / "state",
            key,
            server.getsockname()[1],
            os.ttyname(ends[1]),
            tmp_path / "home/diary",
        )
    for end in ends:
        os.close(end)


def in_host(place: Place, code: str, *, is_trial: bool = False) -> tuple[HostEvent, Sandbox | None]:
    """The last event of a host that loads and steps `code`, and the sandbox that it told."""
    (place.plugins / "hostile.py").write_text(code)

    async def run() -> tuple[HostEvent, Sandbox | None]:
        woken = asyncio.Event()
        runner = ProcessRunner(
            asyncio.get_running_loop(),
            place.plugins,
            woken.set,
            secret=[place.state, place.key.parent],
        )

        async def answer(command: HostCommand) -> HostEvent:
            runner.send(command)
            async with asyncio.timeout(60.0):
                while not (found := list(runner.events())):
                    woken.clear()
                    await woken.wait()
            return found[0]

        try:
            load = Load(1, "hostile", (), "r1", load_platform("burger"), 1)
            event = await answer(StartTrial(load) if is_trial else load)
            if isinstance(event, Loaded):
                event = await answer(Step(1, Inputs(now=1.0, dt=0.0)))
            return event, runner.sandbox
        finally:
            runner.close()

    return asyncio.run(run())


def test_a_free_process_of_this_user_reaches_all_that_the_host_is_denied(place: Place) -> None:
    (place.plugins / "hostile.py").touch()
    command = [sys.executable, sandbox_probes.__file__, str(place)]
    # As the child of a process that may be traced, which this one need not be.
    launcher = "import subprocess, sys; subprocess.run(sys.argv[1:], check=True)"
    done = subprocess.run(
        [sys.executable, "-c", launcher, *command], capture_output=True, text=True, check=True
    )
    found = json.loads(done.stdout)
    assert {name: result for name, result in found.items() if result} == {}
    assert len(found) > 60


@pytest.mark.skipif(not has_landlock(), reason="this kernel has no Landlock")
def test_a_pattern_reaches_nothing_of_its_robot(place: Place) -> None:
    probes = Path(sandbox_probes.__file__).read_text()
    stepped, sandbox = in_host(place, f"{probes}\nPLACE = {place}\n{PLUGIN}")
    assert sandbox == Sandbox(denied=(FILES, NETWORK, PROCESSES))
    assert isinstance(stepped, Stepped)
    found, parts = dict(stepped.outputs.report), (json.loads(str(place)), 0)
    allowed = dict.fromkeys(sandbox_probes.may(*parts), "")
    refused = {*sandbox_probes.reach(*parts), *sandbox_probes.break_out(*parts)}
    wanted = allowed | dict.fromkeys(refused, "denied") | sandbox_probes.OTHERWISE
    assert found.keys() == wanted.keys()
    wrong = [name for name, result in found.items() if result != wanted[name]]
    assert not wrong, "\n".join(f"{name}: {found[name] or 'succeeds'}" for name in wrong)
    assert place.key.read_text() == "secret"
    assert [path.name for path in place.state.iterdir()] == ["latches"]


@pytest.mark.skipif(not has_landlock(), reason="this kernel has no Landlock")
def test_code_is_confined_before_it_is_imported(place: Place) -> None:
    refused, _ = in_host(place, f"open({str(place.key)!r})")
    assert isinstance(refused, LoadRefused)
    assert "PermissionError" in refused.text
    result, _ = in_host(place, f"open({str(place.key)!r})", is_trial=True)
    assert isinstance(result, TrialDone)
    assert "PermissionError" in result.text


@pytest.mark.skipif(not has_landlock(), reason="this kernel has no Landlock")
@pytest.mark.parametrize("name", ["state/latches", "home/.config/swarmd/identities/key.pem"])
def test_tools_inspect_code_in_the_same_sandbox(
    place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    home = tmp_path / "home"
    (home / ".config/swarmd/identities").mkdir(parents=True)
    (home / ".config/swarmd/identities/key.pem").write_text("secret")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    (home / "hostile.py").write_text(f"open({str(tmp_path / name)!r})")
    (row,) = describe_patterns(["hostile"], home, "burger")
    assert "PermissionError" in row["error"]


def test_a_pattern_reads_what_lies_beside_it_and_what_python_imports(
    place: Place, tmp_path: Path
) -> None:
    (place.plugins / "weights").mkdir()
    (place.plugins / "weights/w.txt").write_text("1.5")
    elsewhere = tmp_path / "elsewhere.txt"
    elsewhere.write_text("2.5")
    (place.plugins / "linked.txt").symlink_to(elsewhere)
    code = """
    import os, random, threading, time, numpy, asyncio, json, statistics, zoneinfo
    from pathlib import Path
    from swarmd.api import Outputs, Params, Pattern
    import swarmd.patterns.attraction.pattern
    HERE = Path(__file__).parent
    class Reader(Pattern[Params]):
        needs = frozenset()
        def step(self, inputs):
            texts = [(HERE / name).read_text() for name in ("weights/w.txt", "linked.txt")]
            time.localtime()
            os.urandom(4)
            asyncio.run(asyncio.sleep(0))
            numpy.linalg.inv(numpy.eye(64))
            thread = threading.Thread(target=Path("/dev/null").write_text, args=("x",))
            thread.start()
            thread.join()
            return Outputs(report={"sum": sum(map(float, texts))})
    """
    stepped, _ = in_host(place, textwrap.dedent(code))
    assert isinstance(stepped, Stepped)
    assert stepped.outputs.report == {"sum": 4.0}
