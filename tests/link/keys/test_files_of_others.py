"""Files of others: whatever they hold, none of their code runs unless the user says so.

A hostile file holds code that makes a canary, and each test also shows that the code is armed. The
table of docs/files_of_others.md says what of each kind of file can run, and names the tests of
pictures, checkouts, benchmark tasks and guests in a class check.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import pickle
import shutil
import subprocess
import sys
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from html.parser import HTMLParser
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from swarmd.daemon.recording import messages
from swarmd.daemon.recording.inputs import MEMORY
from swarmd.link.keys.authority import Authority
from swarmd.link.keys.bundle import write_bundle
from swarmd.link.keys.roster import Role
from swarmd.operator.cli.daemon import swarmd
from swarmd.operator.cli.swarmctl import exit_code_of, run_cli
from swarmd.operator.verbs.push.ask import read_source
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.view.trace_source import source_of
from tests.link.keys.test_bundle import bundle_of
from tests.pattern_host.test_wheel import ABOUT, GOOD
from tests.pattern_host.test_wheel import made as wheel_of
from tests.sim.conftest import MAIN, MOODY, write_duo
from tests.support.examples import part
from tests.support.processes import has_landlock
from tests.support.recorded_stories import Story
from tests.support.swarmctl import Finished, swarmctl

pytestmark = [pytest.mark.integration, pytest.mark.usefixtures("forked_starts")]


@dataclass(frozen=True)
class Scene:
    """A folder of somebody else, in which the user works."""

    folder: Path
    canary: Path
    results: Path

    @property
    def code(self) -> str:
        """Python that makes the canary."""
        return f"import pathlib; pathlib.Path({str(self.canary)!r}).touch()\n"

    @property
    def hostile(self) -> object:
        """A value whose pickle makes the canary."""
        return _Hostile(self.canary)

    def write(self, name: str, content: str | bytes) -> Path:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    def run(self, *words: object) -> Finished:
        """A verb in the folder, which answers in words and makes no canary."""
        done = swarmctl(*map(str, words))
        assert "Traceback" not in done.err, words
        assert not self.canary.exists(), words
        return done

    def assert_armed(self, act: Callable[[], object]) -> None:
        """`act`, which is what no verb does, makes the canary."""
        assert not self.canary.exists()
        act()
        assert self.canary.exists()


class _Hostile:
    def __init__(self, canary: Path) -> None:
        self.canary = canary

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.canary,)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of two short runs with a pattern and a metric of files."""
    folder = tmp_path_factory.mktemp("made")
    metric = folder / "warm.py"
    metric.write_text("def warm(trace):\n    return trace.t\n")
    with pytest.MonkeyPatch.context() as here:
        here.setenv("XDG_STATE_HOME", str(folder))
        simulate(
            write_duo(folder),
            2,
            set={"duration": 0.4},
            out=folder / "x",
            metrics=[f"{metric}:warm"],
        )
    return folder / "x"


@pytest.fixture
def scene(tmp_path: Path, made: Path, monkeypatch: pytest.MonkeyPatch) -> Scene:
    home, folder = tmp_path / "home", tmp_path / "others"
    home.mkdir()
    folder.mkdir()
    monkeypatch.setenv("HOME", str(home))
    for name in ("XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME", "SWARM_CONTEXT"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(folder)
    return Scene(folder, tmp_path / "canary", made)


def hostile_results(scene: Scene, which: str) -> None:
    """Results in `x` whose manifest names a hostile metric or pattern, with its true digest."""
    shutil.copytree(scene.results, scene.folder / "x")
    path = scene.folder / "x" / "manifest.json"
    manifest: dict[str, Any] = json.loads(path.read_text())
    if which == "metric":
        code, name, origin = "def warm(trace):\n    return trace.t\n", "x/warm.py", ":warm"
        manifest["metrics"][0]["origin"] = f"{name}{origin}"
    else:
        # `~` is the home for a scenario, and was a folder's name for the digests.
        (scene.folder.parent / "home").rename(scene.folder / "home")
        os.environ["HOME"] = str(scene.folder / "home")
        code, name, origin = MOODY, "home/p/moody.py", ""
        for variant in manifest["variants"]:
            variant["effective"]["plugin_dir"] = "~/p"
        manifest["metrics"].clear()
    text = scene.code + code
    scene.write(name, text)
    digest = hashlib.sha256(text.encode()).hexdigest()
    manifest["plugins"][f"{name}{origin}".replace("home/", "~/")] = digest
    path.write_text(json.dumps(manifest))


@pytest.mark.integration
def test_a_folder_of_the_name_of_the_home_sign_is_not_imported(scene: Scene) -> None:
    """`~/p` is the home's for what is compared: a folder `~` of the others holds the code."""
    hostile_results(scene, "pattern")
    shutil.rmtree(scene.folder / "home" / "p")
    scene.write("~/p/moody.py", scene.code + MOODY)
    scene.run("exp", "rerun", "x", "-j", "1")


@pytest.mark.integration
@pytest.mark.parametrize("name", ["plots", "testing"])
def test_a_pattern_in_a_folder_that_runs_of_ours_do_not_import(scene: Scene, name: str) -> None:
    hostile_results(scene, "pattern")
    path = scene.folder / "x" / "manifest.json"
    manifest = json.loads(path.read_text())
    for variant in manifest["variants"]:
        variant["effective"]["plugin_dir"] = "home/q"
        for group in variant["effective"]["groups"].values():
            group["pattern"] = name
    path.write_text(json.dumps(manifest))
    scene.write(f"home/q/{name}/pattern.py", scene.code + MOODY)
    done = scene.run("exp", "rerun", "x", "-j", "1")
    assert (done.code, "--trust" in done.err) == (2, True)
    assert f"home/q/{name}/pattern.py" in done.err
    scene.assert_armed(lambda: swarmctl("exp", "rerun", "x", "-j", "1", "--trust", "--out", "y"))
    again = json.loads((scene.folder / "y" / "manifest.json").read_text())
    assert f"home/q/{name}/pattern.py" in again["plugins"]


ASKED = ("--metrics", "warm.py:warm")
RESULTS: dict[str, list[tuple[str, ...]]] = {
    "metric": [
        ("exp", "rerun", "x"),
        ("exp", "rerun", "x", "--out", "again"),
        ("exp", "show", "x"),
        ("exp", "show", "x", *ASKED),
        ("exp", "check", "x", "warm.py:warm >= 0"),
        ("exp", "compare", "x", "x", *ASKED),
        ("exp", "merge", "x", "--out", "all", *ASKED),
        ("exp", "plot", "x", *ASKED, "--only", "over_time"),
        ("exp", "report", "x", *ASKED),
    ],
    "pattern": [
        ("exp", "rerun", "x"),
        ("exp", "show", "x"),
        ("exp", "plot", "x", "--only", "intervals"),
        ("exp", "export", "x", "--to", "csv"),
    ],
}


@pytest.mark.integration
@pytest.mark.parametrize("which", RESULTS)
def test_results_run_code_with_trust_alone(scene: Scene, which: str) -> None:
    hostile_results(scene, which)
    for words in RESULTS[which]:
        done = scene.run(*words)
        if "rerun" in words or ASKED[0] in words:
            assert (done.code, done.err.count("\n")) == (2, 1)
            assert "--trust" in done.err
    source_of(scene.folder / "x").rows()  # what `exp view` shows
    assert not scene.canary.exists()
    scene.assert_armed(lambda: swarmctl("exp", "rerun", "x", "-j", "1", "--trust"))
    scene.canary.unlink()
    scene.assert_armed(lambda: swarmctl("exp", "rerun", "x", "-j", "1"))  # it is known now


def test_the_report_of_results_has_no_element_of_their_texts(scene: Scene) -> None:
    shutil.copytree(scene.results, scene.folder / "x")
    evil = "</script><script>alert(1)</script><img src=x onerror=alert(1)>"
    path = scene.folder / "x" / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest |= {"scenario": evil, "command": [evil], "created": evil}
    manifest["made_with"] |= {evil: evil, "kernels": evil}
    manifest["plugins"] = {evil: evil}
    manifest["git"] = {evil: {"commit": evil, "is_dirty": True}}
    manifest["metrics"][0] |= {"unit": evil, "origin": evil}
    manifest["variants"][0]["effective"] |= {"name": evil, "description": evil}
    path.write_text(json.dumps(manifest))
    scene.run("exp", "report", "x", "--out", "x.html")
    elements: list[tuple[str, dict[str, str | None]]] = []

    class Elements(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            elements.append((tag, dict(attrs)))

    page = (scene.folder / "x.html").read_text()
    Elements().feed(page)
    kinds = {attrs.get("type") for tag, attrs in elements if tag == "script"}
    pictures = [str(attrs.get("src")) for tag, attrs in elements if tag == "img"]
    assert "alert(1)" in page
    assert kinds == {"application/json", "module"}
    assert pictures
    assert all(one.startswith("data:image/png") for one in pictures)
    assert not [name for _, attrs in elements for name in attrs if name.startswith("on")]


YAML_FILES = {
    "scenario": ("exp", "run", "x.yaml", "--seeds", 1),
    "demo": ("demo", "x.yaml"),
    "tuned scenario": ("exp", "tune", "x.yaml", "--metric", "gather_time:min"),
    "benchmark task": ("exp", "bench", "x.yaml"),
    "mission": ("mission", "check", "x.yaml"),
    "swarm": ("members", "--config", "x.yaml"),
    "goal": ("apply", "x.yaml", "--yes"),
    "platform": ("patterns", "list", "--platform", "./x.yaml"),
}


@pytest.mark.integration
@pytest.mark.parametrize("words", YAML_FILES.values(), ids=YAML_FILES)
def test_yaml_makes_values_alone(scene: Scene, words: tuple[object, ...]) -> None:
    for tag in ("python/object/apply:os.system", "python/name:os.system", "python/object/new:x.Y"):
        scene.write("x.yaml", f"mission: !!{tag} ['touch {scene.canary}']\n")
        done = scene.run(*words)
        assert done.code != 0
        assert "tag" in done.err, done.err  # the loader refuses it, nothing else


def test_policies_and_traces_make_values_alone(scene: Scene) -> None:
    arrays = np.array([scene.hostile], dtype=object)
    file = io.BytesIO()
    np.savez(file, allow_pickle=True, spec=arrays, head=arrays, activation=arrays)
    shutil.copytree(scene.results, scene.folder / "x")
    for path in ("policy.npz", "policy.onnx", "trace.npz", "x/traces/s0000.npz"):
        scene.write(path, file.getvalue())
    for words in (
        ("plugin", "new", "gather", "--policy", "policy.npz"),
        ("plugin", "new", "gather", "--policy", "policy.onnx"),
        ("exp", "measure", "trace.npz"),
        ("exp", "video", "trace.npz"),
        ("exp", "export", "x", "--to", "csv"),
    ):
        assert scene.run(*words).code != 0, words
    scene.assert_armed(lambda: np.load("trace.npz", allow_pickle=True)["head"])


def test_recordings_make_values_alone(scene: Scene) -> None:
    story = Story(scene.folder / "made")
    story.recorder.begin(story.robot)
    story.run("drive", 0.5)
    whole = story.recorder.finish().path
    data = pickle.dumps(scene.hostile)
    with whole.open("rb") as source, (scene.folder / "x.mcap").open("wb") as target:
        reader, writer = make_reader(source), Writer(target)
        writer.start()
        for about in reader.iter_metadata():
            writer.add_metadata(about.name, {**about.metadata})
        channels = {}
        for schema, channel, one in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if channel.id not in channels:
                # A definition becomes Python in rosbags, which knows these types by itself.
                text = schema.data + b"\nstring x');" + scene.code.strip().encode() + b"#\n"
                kind = writer.register_schema(schema.name, schema.encoding, text)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, kind
                )
            packed = messages.bytes_message(zlib.compress(data), 0.0).payload
            writer.add_message(
                channels[channel.id],
                one.log_time,
                packed if channel.topic == MEMORY else one.data,
                one.publish_time,
                one.sequence,
            )
        writer.finish()  # type: ignore[no-untyped-call]
    for words in (
        ("replay", "x.mcap"),
        ("record", "merge", "x.mcap", "-o", "y.mcap"),
        ("exp", "report", "x.mcap"),
    ):
        scene.run(*words)
    scene.assert_armed(lambda: pickle.loads(data))


ENDLESS: dict[str, tuple[object, ...]] = {
    "x/manifest.json": ("exp", "show", "x"),
    "x/runs.csv": ("exp", "report", "x"),
    "x/failures.json": ("exp", "show", "x"),
    "x/traces/s0000.npz": ("exp", "merge", "x", "--out", "y"),
    "trace.npz": ("exp", "measure", "trace.npz"),
    "t/tune.json": ("exp", "tune", "drive", "--metric", "path_length:max", "--out", "t"),
    "warm.py": ("exp", "show", "x", "--metrics", "./warm.py:warm"),
    "policy.npz": ("plugin", "new", "own", "--policy", "policy.npz"),
    "m.yaml": ("exp", "run", "m.yaml", "--seeds", 1),
    "a.mcap": ("record", "merge", "a.mcap", "-o", "b.mcap"),
    "a.bundle": ("keys", "install", "a.bundle"),
    "class/anna.py": ("class", "check", "class", "--lesson", 2),
}
"""Files of others, and a verb that reads each."""


@pytest.mark.parametrize(
    ("place", "target"),
    part(
        [*zip(ENDLESS, cycle(["/dev/zero", "pipe"]))],
        [*zip(ENDLESS, cycle(["pipe", "/dev/zero"]))],
    ),
)
def test_a_file_that_never_ends_is_not_read(scene: Scene, place: str, target: str) -> None:
    shutil.copytree(scene.results, scene.folder / "x")
    scene.write(place, "").unlink()
    os.mkfifo(scene.folder / "pipe")
    (scene.folder / place).symlink_to(scene.folder / target)
    done = scene.run(*ENDLESS[place])
    assert done.code != 0
    assert "is not a regular file" in done.err + done.out


def test_the_state_of_a_tuning_names_no_code_that_runs(scene: Scene) -> None:
    hostile_results(scene, "metric")
    for name in ("races/01", "held_out"):
        shutil.copytree(scene.folder / "x", scene.folder / "t" / name)
    manifest = json.loads((scene.folder / "x/manifest.json").read_text())
    asked = {"metric": "x/warm.py:warm", "goal": "min", "budget": 4, "candidates": 2}
    state = {"asked": asked, "manifest": manifest, "races": [[{"candidate": 0, "values": {}}]]}
    scene.write("t/tune.json", json.dumps(state))
    words = ("--metric", "path_length:max", "--seeds", 2, "--budget", 4, "--candidates", 2)
    done = scene.run("exp", "tune", "drive", *words, "--held-out", 0, "--out", "t")
    assert done.code == 2
    assert "t/tune.json" in done.err or "t: " in done.err, done.err


@pytest.mark.parametrize("key", ["driver", "driver_options", "plugin_dir", "state_dir"])
def test_a_bundle_sets_no_program_and_no_folder(scene: Scene, key: str) -> None:
    program = scene.write("python", f"#!/bin/sh\ntouch {scene.canary}\n")
    settings = {"driver": "ros1", "driver_options": {"python": str(program)}}
    settings |= {"plugin_dir": ".", "state_dir": "."}
    authority = Authority.create(scene.folder / "authority", "meadow")
    authority.change(add={"r1": Role.ROBOT, "alice": Role.OPERATOR})
    for name in ("r1", "alice"):
        bundle = bundle_of(authority, name, **{key: settings[key]})
        write_bundle(scene.folder / f"{name}.bundle", bundle)
    done = scene.run("keys", "install", "alice.bundle")
    assert (done.code, f"'{key}'" in done.err) == (2, True)
    (scene.folder / "card").mkdir()
    words = ["install", "r1.bundle", "--root", "card"]
    assert run_cli(swarmd, words, "swarmd", exit_code_of) == 2
    assert list((scene.folder / "card").rglob("*")) == []


@pytest.mark.integration
@pytest.mark.skipif(not has_landlock(), reason="this kernel has no Landlock")
def test_code_that_is_checked_runs_in_the_sandbox(scene: Scene) -> None:
    pattern = scene.code + MOODY
    scene.write("moody.py", pattern)
    scene.write("patrol.yaml", "mission: x\nparts: {go: {pattern: moody}}\npart: go\n")
    assert scene.run("plugin", "check", "moody.py").code == 1
    assert scene.run("mission", "check", "patrol.yaml").code == 2
    scene.run("patterns", "show", "moody", "--plugin-dir", ".")
    wheel = {**GOOD, "own_code/__init__.py": pattern, f"{ABOUT}/own.py": pattern}
    assert read_source(scene.write("own.whl", wheel_of(wheel))).kind == "wheel"
    assert not scene.canary.exists()
    scene.assert_armed(lambda: exec(scene.code))


def test_a_scenario_runs_the_patterns_of_its_folder_and_nothing_else(scene: Scene) -> None:
    path = write_duo(scene.folder)
    scene.write("duo/plugins/other.py", scene.code)  # no group runs it
    load_scenario(path)
    assert not scene.canary.exists()
    scene.write("duo/plugins/moody.py", scene.code + MOODY)
    scene.assert_armed(lambda: load_scenario(path))  # as docs/files_of_others.md says


NOTEBOOK = ("exp run", "exp view", "exp measure", "replay", "plugin check", "mission check")


@pytest.mark.integration
def test_a_notebook_is_opened_by_no_verb(scene: Scene) -> None:
    cell = {"cell_type": "code", "source": scene.code, "metadata": {}, "outputs": []}
    scene.write("x.ipynb", json.dumps({"cells": [cell], "nbformat": 4, "metadata": {}}))
    for verb in NOTEBOOK:
        assert scene.run(*verb.split(), "x.ipynb").code != 0, verb


@pytest.mark.integration
@pytest.mark.usefixtures("real_starts")
def test_modules_and_settings_in_the_working_folder_are_not_read(scene: Scene) -> None:
    for name in ("msgspec", "numpy", "json", "sitecustomize", "usercustomize", "swarmd"):
        scene.write(f"{name}.py", scene.code)
    scene.write("conftest.py", scene.code)
    duo = write_duo(scene.folder)
    words = ("exp", "run", str(duo), "--seeds", "1", "--set", "duration=0.2", "-j", "1")
    done = subprocess.run(
        [sys.executable, "-P", "-c", MAIN, *words, "--out", "made"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, scene.canary.exists()) == (0, False), done.stderr
    scene.assert_armed(
        lambda: subprocess.run([sys.executable, "-m", "json"], check=False, capture_output=True)
    )
