"""Files of others: whatever they hold, none of their code runs unless the user says so.

Each hostile file holds code that makes a canary file. The table in docs/security.md names what of a
file can run; `test_the_hostile_files_are_armed` shows that the canary appears where it may.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.kit.policy_network import network_from_bytes
from swarmd.sim.experiments.simulate import simulate
from tests.sim.conftest import MOODY, write_duo
from tests.support.swarmctl import Finished, swarmctl


@dataclass(frozen=True)
class Scene:
    """A folder of somebody else, in which the user works; `code` makes the canary."""

    folder: Path
    canary: Path
    results: Path

    @property
    def code(self) -> str:
        return f"import pathlib; pathlib.Path({str(self.canary)!r}).touch()\n"

    def run(self, *words: object) -> Finished:
        """A verb in the folder, which answers in words."""
        done = swarmctl(*map(str, words))
        assert "Traceback" not in done.err
        return done


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of two short runs with a pattern and a metric of files."""
    folder = tmp_path_factory.mktemp("made")
    metric = folder / "warm.py"
    metric.write_text("def warm(trace):\n    return trace.t\n")
    simulate(
        write_duo(folder), 2, set={"duration": 0.4}, out=folder / "x", metrics=[f"{metric}:warm"]
    )
    return folder / "x"


@pytest.fixture
def scene(tmp_path: Path, made: Path, monkeypatch: pytest.MonkeyPatch) -> Scene:
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    for name in ("XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME", "SWARM_CONTEXT"):
        monkeypatch.delenv(name, raising=False)
    folder = tmp_path / "others"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return Scene(folder, tmp_path / "canary", made)


def evil_results(scene: Scene, which: str) -> None:
    """Results in `x` whose manifest names a hostile metric or pattern, with its true digest."""
    shutil.copytree(scene.results, scene.folder / "x")
    path = scene.folder / "x" / "manifest.json"
    manifest: dict[str, Any] = json.loads(path.read_text())
    metric = scene.code + "def warm(trace):\n    return trace.t\n"
    plugins, code = {}, {"x/warm.py": metric, "x/p/moody.py": scene.code + MOODY}
    if which == "metric":
        manifest["metrics"][0]["origin"] = "x/warm.py:warm"
        plugins["x/warm.py:warm"] = code["x/warm.py"]
    else:
        for variant in manifest["variants"]:
            variant["effective"]["plugin_dir"] = "x/p"
        manifest["metrics"].clear()
        plugins["x/p/moody.py"] = code["x/p/moody.py"]
    (scene.folder / "x/p").mkdir()
    for name, text in code.items():
        (scene.folder / name).write_text(text)
    manifest["plugins"] = {
        name: hashlib.sha256(text.encode()).hexdigest() for name, text in plugins.items()
    }
    path.write_text(json.dumps(manifest))


RESULTS = {
    "rerun": ("exp", "rerun", "x"),
    "rerun-out": ("exp", "rerun", "x", "--out", "again"),
    "show": ("exp", "show", "x"),
    "show-metric": ("exp", "show", "x", "--metrics", "warm.py:warm"),
    "check": ("exp", "check", "x", "warm.py:warm >= 0"),
    "compare": ("exp", "compare", "x", "x", "--metrics", "warm.py:warm"),
    "merge": ("exp", "merge", "x", "--out", "all", "--metrics", "warm.py:warm"),
    "plot": ("exp", "plot", "x"),
    "plot-metric": ("exp", "plot", "x", "--metrics", "warm.py:warm", "--only", "over_time"),
    "report": ("exp", "report", "x"),
    "report-metric": ("exp", "report", "x", "--metrics", "warm.py:warm"),
    "export": ("exp", "export", "x", "--to", "csv"),
}


@pytest.mark.parametrize("which", ["metric", "pattern"])
@pytest.mark.parametrize("words", RESULTS.values(), ids=RESULTS)
def test_results_run_no_code(scene: Scene, which: str, words: tuple[str, ...]) -> None:
    evil_results(scene, which)
    scene.run(*words)
    assert not scene.canary.exists()


@pytest.mark.parametrize("which", ["metric", "pattern"])
def test_the_hostile_files_are_armed(scene: Scene, which: str) -> None:
    evil_results(scene, which)
    refused = scene.run("exp", "rerun", "x", "-j", 1)
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "--trust" in refused.err
    scene.run("exp", "rerun", "x", "-j", 1, "--trust")
    assert scene.canary.exists()


YAML_FILES = {
    "scenario": ("exp", "run", "x.yaml", "--seeds", 1),
    "demo": ("demo", "x.yaml", "--headless"),
    "mission": ("mission", "check", "x.yaml"),
    "run-mission": ("run", "mission", "--all", "-p", "file=@x.yaml"),
    "swarm": ("members", "--config", "x.yaml"),
    "platform": ("platform", "check", "x.yaml"),
    "tuning": ("exp", "tune", "x.yaml", "--param", "a=0..1", "--goal", "min mdc"),
}


@pytest.mark.parametrize("words", YAML_FILES.values(), ids=YAML_FILES)
@pytest.mark.parametrize(
    "tag", ["!!python/object/apply:os.system", "!!python/name:os.system", "!x"]
)
def test_a_yaml_file_makes_no_objects(scene: Scene, tag: str, words: tuple[str, ...]) -> None:
    (scene.folder / "x.yaml").write_text(f"name: {tag} ['touch {scene.canary}']\n")
    assert scene.run(*words).code != 0
    assert not scene.canary.exists()


def test_a_policy_file_makes_no_objects(scene: Scene) -> None:
    class Hostile:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (scene.canary,)

    for arrays in (
        {"spec": np.array([Hostile()], dtype=object)},
        {"weight_0": np.array(Hostile())},
    ):
        file = io.BytesIO()
        np.savez(file, allow_pickle=True, **arrays)
        with pytest.raises(ConfigError):
            network_from_bytes(file.getvalue())
    assert not scene.canary.exists()


def test_a_trace_makes_no_objects(scene: Scene) -> None:
    class Hostile:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (scene.canary,)

    shutil.copytree(scene.results, scene.folder / "x")
    for trace in (scene.folder / "x").rglob("*.npz"):
        np.savez(trace, head=np.array([Hostile()], dtype=object))
    for name in ("rerun", "plot", "report"):
        scene.run(*RESULTS[name])
    assert not scene.canary.exists()
