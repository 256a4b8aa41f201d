"""The notebooks and the script of the README: each runs to its end, and leaves no process."""

from __future__ import annotations

import contextlib
import json
import runpy
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.processes import CAP, wait_until

pytestmark = pytest.mark.integration
ROOT = Path(__file__).resolve().parents[2]
SEARCH = ROOT / "examples" / "notebooks" / "mission_search.ipynb"
NOTEBOOKS = sorted({*SEARCH.parent.glob("*.ipynb")} - {SEARCH})
SMALL = "TRIALS, SEEDS, HELD_OUT, DURATION, JOBS = 1, range(1), range(9, 10), 1.0, 1"
CELL_TIME = 60  # s
MARK = "SWARMD_TEST_NOTEBOOK"


@pytest.mark.filterwarnings("default")  # of the libraries that execute notebooks
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib  # these three take 0.3 s of each worker that collects tests
    import nbformat
    from nbclient import NotebookClient

    monkeypatch.setenv("MPLCONFIGDIR", matplotlib.get_cachedir())
    for key in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(key, str(tmp_path))
    monkeypatch.setenv(MARK, path.stem)
    notebook: Any = nbformat.read(path, as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells)  # they are committed without
    NotebookClient(notebook, timeout=CELL_TIME, kernel_name="python3").execute()
    wait_until(lambda: not marked(path.stem), "the kernel, the world and the daemons have ended")
    texts = [str(out) for cell in notebook.cells for out in cell.get("outputs", ())]
    assert any("applied" in text for text in texts)
    if path.stem == "first_swarm":
        assert any("<svg" in text for text in texts)


def test_the_search_for_missions_ends_with_held_out_seeds_and_controls(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("optuna.logging.set_verbosity", lambda level: None)  # of all of optuna
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    cells = json.loads(SEARCH.read_text())["cells"]
    assert all(not cell.get("outputs") for cell in cells)
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    names: dict[str, Any] = {}
    for cell in code:  # in this process, since a kernel of its own takes as long as the runs
        is_given = "parameters" in cell["metadata"].get("tags", ())
        exec(SMALL if is_given else "".join(cell["source"]), names)
    told = capsys.readouterr().out
    assert yaml.safe_load(told.partition("\n\n")[0])["mission"].startswith("Trial 0")
    assert list(names["rows"]) == ["found", "by hand", "random walk", "robots that stand"]
    assert all(0.0 <= values.mean() <= 1.0 for values in names["rows"].values())


def marked(name: str) -> list[str]:
    """The processes that were started with the mark of a notebook."""
    found = []
    for environ in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):  # of another user, or it has ended
            if f"{MARK}={name}".encode() in environ.read_bytes().split(b"\0"):
                found.append(environ.parent.name)
    return found


def test_the_script_of_the_readme_runs(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(ROOT / "examples" / "watch_and_stop.py"))
    told = capsys.readouterr().out
    assert told.count("3 targeted, 3 applied") == 2
    assert "dispersion" in told


def test_the_script_of_the_readme_ends_with_one_line_at_an_interrupt() -> None:
    command = [sys.executable, "-u", str(ROOT / "examples" / "watch_and_stop.py")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "3 targeted, 3 applied\n"
            process.send_signal(signal.SIGINT)
            _, told = process.communicate(timeout=CAP)
        finally:
            process.kill()
    assert (process.returncode, told) == (1, "interrupted: the simulated swarm has ended\n")
