"""Processes that are forked with their imports: what they get, and how they end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from multiprocessing import current_process, forkserver
from multiprocessing.util import get_temp_dir
from pathlib import Path

import pytest

from swarmd.core.fork_server import (
    ForkedProcess,
    fork_main,
    start_server,
    use_short_folder,
)
from swarmd.sim.live.fleet import DAEMON_MODULES
from swarmd.testing.driver_contract import is_running
from tests.support.processes import MODULES, wait_until

pytestmark = pytest.mark.integration

MODULE = "tests.support.forked_module"
PARENT = f"""
import signal, sys
from pathlib import Path
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
from swarmd.core.fork_server import fork_main, start_server
start_server(())  # of a script that runs all when it is imported
log = Path(sys.argv[1])
print(fork_main("child", "{MODULE}", ("wait", "tied"), stdout=None, stderr=log).pid, flush=True)
signal.pause()
"""

INTERRUPTED = f"""
import os, signal, sys
from pathlib import Path
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
from swarmd.core.fork_server import fork_main, start_server
folder = Path(sys.argv[1])
start_server(("slowly_imported",))
while not (folder / "importing").exists():
    pass
signal.signal(signal.SIGINT, signal.SIG_IGN)
os.killpg(0, signal.SIGINT)  # as Ctrl-C in a terminal
(folder / "go").touch()
fork_main("child", "{MODULE}", ("tied",), stdout=folder / "out", stderr=folder / "err").wait(30)
"""
SLOWLY_IMPORTED = """
from pathlib import Path
folder = Path(__file__).parent
(folder / "importing").touch()
while not (folder / "go").exists():
    pass
"""


def test_a_long_tmpdir_is_left_for_a_socket(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The path of a Unix socket has at most 107 bytes (unix(7))."""
    long = tmp_path / ("a" * 60) / ("b" * 50)
    long.mkdir(parents=True)
    monkeypatch.setattr(current_process(), "_config", {})
    monkeypatch.setattr(tempfile, "tempdir", str(long))
    use_short_folder()
    assert tempfile.gettempdir() == str(long)
    folder = get_temp_dir()
    assert len(os.fsencode(folder)) + len("/listener-12345678") <= 107
    monkeypatch.setattr(current_process(), "_config", {})
    monkeypatch.setattr(tempfile, "tempdir", "/var/tmp")  # short enough to be kept
    use_short_folder()
    assert Path(get_temp_dir()).parent == Path("/var/tmp")
    assert Path(folder).parent == Path("/tmp")


def test_the_modules_of_the_servers_exist() -> None:
    """A server says nothing about a module that it cannot import."""
    assert [name for name in {*DAEMON_MODULES, *MODULES} if find_spec(name) is None] == []


def fork(folder: Path, *arguments: str) -> ForkedProcess:
    start_server(())
    out, err = folder / "out", folder / "err"
    return fork_main("forked-robot", MODULE, arguments, stdout=out, stderr=err)


def test_a_forked_process_gets_what_it_would_get_from_a_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GIVEN", "yes")
    monkeypatch.chdir(tmp_path)
    forked = fork(tmp_path, "one", "two")
    assert forked.wait(30.0) == 7
    assert forked.returncode == 7
    told = json.loads((tmp_path / "out").read_text())
    parent = str(told.pop("parent"))
    assert told == {
        "arguments": ["one", "two", "--die-with-parent", parent],
        "folder": str(tmp_path),
        "name": "forked-robot",
        "environ": "yes",
        "safe_path": None,
        "input": "",
        "is_leader": True,
        "takes_sigint": True,
    }
    assert (tmp_path / "err").read_text() == "error\n"


def test_a_forked_process_is_ended_by_signals_and_waited_for(tmp_path: Path) -> None:
    forked = fork(tmp_path, "wait")
    wait_until(lambda: (tmp_path / "err").read_text() == "error\n", "it runs")
    assert forked.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        forked.wait(0.01)
    forked.kill()
    assert forked.wait(30.0) == -signal.SIGKILL
    forked.terminate()  # nothing: it has ended
    other = fork(tmp_path, "wait")
    other.terminate()
    assert other.wait(30.0) == -signal.SIGTERM


def test_a_forked_process_whose_server_was_killed_was_killed(tmp_path: Path) -> None:
    forked = fork(tmp_path, "wait", "tied")
    wait_until(lambda: (tmp_path / "err").read_text() == "error\n", "it runs")
    os.kill(forkserver._forkserver._forkserver_pid, signal.SIGKILL)  # type: ignore[attr-defined]
    assert forked.wait(30.0) == -signal.SIGKILL


def test_forked_processes_end_with_their_parent(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    command = [sys.executable, str(script), str(tmp_path / "err")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        wait_until(lambda: (tmp_path / "err").read_text() == "error\n", "the child runs")
        assert is_running(child)
        parent.kill()
    wait_until(lambda: not is_running(child), "the child has ended")


def test_ctrl_c_reaches_neither_the_imports_of_the_server_nor_its_forks(tmp_path: Path) -> None:
    (tmp_path / "slowly_imported.py").write_text(SLOWLY_IMPORTED)
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, str(tmp_path)],
        capture_output=True,
        text=True,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},  # the server has no other path of a test
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    told = json.loads((tmp_path / "out").read_text())
    assert told["takes_sigint"] is True


def test_a_process_that_has_ended_unnoticed_gets_no_signal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server has taken its exit code, and this process has not read it yet."""
    forked = fork(tmp_path, "one", "two")
    assert forked.wait(30.0) == 7
    monkeypatch.setattr(ForkedProcess, "poll", lambda _: None)
    wait_until(lambda: not is_running(forked.pid), "the server has taken its exit code")
    forked.kill()
    monkeypatch.undo()
    assert forked.returncode == 7
