"""Recorded runs and live simulated worlds on the page, in a real browser."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.view.trace_source import source_of
from tests.sim.conftest import swarmctl_in, write_duo
from tests.support.chromium import Page

pytestmark = pytest.mark.integration

SWARMCTL = str(Path(sys.executable).with_name("swarmctl"))
ROBOTS = "[...window.swarm.model.robots.values()]"


@contextlib.contextmanager
def begun(folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """A `swarmctl`, which has ended by Ctrl-C when this returns."""
    process = subprocess.Popen(
        [SWARMCTL, *words, "--port", "0"],
        cwd=folder,
        env={**os.environ, "HOME": str(folder)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)


def address_in(stream: IO[str] | None) -> str:
    """The address of the page in the output of a verb."""
    assert stream is not None
    for line in stream:
        if line.startswith("page: "):
            return line.removeprefix("page: ").strip()
    raise AssertionError("it printed no address")


def seek(page: Page, time: float) -> None:
    """Move the slider of the timeline."""
    page.until("Number(document.getElementById('seek').max) > 1", "the length of the run")
    page.evaluate(
        f"(() => {{ const s = document.getElementById('seek'); s.value = {time};"
        " s.dispatchEvent(new Event('input')); })()"
    )


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an experiment with seeds 0 and 1."""
    home = tmp_path_factory.mktemp("experiment")
    words = ("exp", "run", write_duo(home), "--seeds", "2", "-j", "1", "--out", "results")
    done = swarmctl_in(home)(*words)
    assert done.returncode == 0, done.stderr
    return home / "results"


def test_recorded_runs_play_seek_and_change(results: Path, page: Page) -> None:
    with begun(results.parent, "exp", "view", "results", "--seed", "1") as process:
        page.open(address_in(process.stdout))
        page.until(f"{ROBOTS}.length === 2 && {ROBOTS}.every((one) => one.row.state)", "the robots")
        assert page.evaluate("document.getElementById('run-shown').value") == "seed 1"
        page.click("#play")
        page.evaluate("swarm.timeline.play(false)")  # the click begins a run anew that has ended
        page.until("!window.swarm.model.playback.is_playing", "a pause")
        seek(page, 1.5)
        page.until("Math.abs(window.swarm.model.time - 1.5) < 0.06", "the chosen time")
        # The whole run is plotted, and a click on the plots goes there.
        end = "swarm.model.plots.times.at(-1) > swarm.model.playback.duration - 0.01"
        page.until(end, "the plots")
        assert page.evaluate("swarm.model.plots.values.clusters.every((one) => one >= 1)")
        x, y, width = page.evaluate(
            "(() => { const b = document.getElementById('plots').getBoundingClientRect();"
            " return [b.x + swarm.plots.left, b.y + b.height / 3,"
            " b.width - swarm.plots.left - swarm.plots.right]; })()"
        )
        page.mouse(x + width / 2, y)
        page.until("Math.abs(swarm.model.time - swarm.model.playback.duration / 2) < 0.1", "middle")
        before = page.evaluate(f"{ROBOTS}.map((one) => one.x)")
        page.click("#run-before")
        page.until("window.swarm.model.playback.run === 'seed 0'", "the other run")
        page.until(f"{ROBOTS}.every((one) => one.x === one.x)", "places in the other run")
        assert page.evaluate(f"{ROBOTS}.map((one) => one.x)") != before
        assert page.errors == []


def test_a_folder_without_the_wanted_run_is_one_clear_error(results: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(results, copy)
    with pytest.raises(ConfigError, match="seed '7'"):
        source_of(copy, seed=7)
    with pytest.raises(ConfigError, match="variant 'fast'"):
        source_of(copy, variant="fast")
    (copy / "traces" / "s0001.npz").write_bytes(b"PK torn")
    with pytest.raises(ConfigError, match=r"s0001\.npz"):
        source_of(copy, seed=1)
    source = source_of(copy)
    with pytest.raises(ConfigError, match=r"s0001\.npz"):
        source.playback.choose("seed 1")
    assert source.playback.run == "seed 0"
    shutil.rmtree(copy / "traces")
    with pytest.raises(ConfigError, match="no traces"):
        source_of(copy)
    recording = tmp_path / "evening.mcap"
    recording.touch()
    for other in (tmp_path, recording):
        with pytest.raises(ConfigError, match="no recorded runs"):
            source_of(other)
    alone = source_of(results / "traces" / "s0001.npz")
    assert alone.playback.runs == ["s0001.npz"]
    with pytest.raises(ConfigError, match="--seed"):
        source_of(results / "traces" / "s0001.npz", seed=1)


def test_a_demo_shows_true_positions_answers_and_ends(tmp_path: Path, page: Page) -> None:
    words = ["demo", "--web", "--headless", "-n", "2", "--seconds", "600", "--pattern", "drive"]
    words += ["--arena", "6x4,box:2:0:0.4:1:0,box:-2:0:0.3:0.3:0:2", "-p", "speed=0.02"]
    words += ["--layout", "list:-1:1.5:90,1:-1:180"]
    with begun(tmp_path, *words) as process:
        page.open(address_in(process.stderr))
        page.until(f"{ROBOTS}.filter((one) => one.row.state === 'running').length === 2", "a run")
        first, second = page.evaluate(f"{ROBOTS}.map((one) => [one.x, one.y])")
        assert first == pytest.approx([-1.0, 1.5], abs=0.2)  # by odometry both would begin at 0, 0
        assert second == pytest.approx([1.0, -1.0], abs=0.2)
        arena = page.evaluate("window.swarm.model.arena")
        assert arena["size"] == [6.0, 4.0]
        assert len(arena["shapes"]) == 1
        page.until("window.swarm.model.boxes.length === 1", "the movable box")
        page.until("window.swarm.model.patterns.some((one) => one.params)", "parameters")
        page.click("#stop")
        page.until(f"{ROBOTS}.filter((one) => one.row.state === 'stopped').length === 2", "stops")

        process.send_signal(signal.SIGINT)
        page.until("document.getElementById('banner').textContent.includes('ended')", "an end")
        page.until("document.querySelectorAll('tr.stale').length === 2", "robots that are gone")
        assert process.wait(timeout=60) == 130


def test_a_recorded_run_has_its_whole_name_and_its_play_button_on_a_phone(
    results: Path, page: Page
) -> None:
    with begun(results.parent, "exp", "view", "results", "--seed", "1") as process:
        page.resize(390, 844, is_phone=True)
        page.open(address_in(process.stdout))
        page.until(f"{ROBOTS}.length === 2 && {ROBOTS}.every((one) => one.row.state)", "the robots")
        box = page.evaluate(
            "(() => { const { left, right, top, bottom } = play.getBoundingClientRect();"
            " return [left, right, top, bottom, document.elementFromPoint((left + right) / 2,"
            " (top + bottom) / 2).id]; })()"
        )
        assert 0 <= box[0] < box[1] <= 390
        assert 0 <= box[2] < box[3] <= 844
        assert box[4] == "play"
        page.evaluate("swarm.timeline.play(true)")
        page.click("#play")
        page.until("!swarm.model.playback.is_playing", "a pause")
        # No command looks alive in a recorded run.
        hidden = "['run-open', 'stop', 'reset', 'estop-reset'].filter((id) =>"
        hidden += " document.getElementById(id).checkVisibility())"
        assert page.evaluate(hidden) == []
        for width in (390, 1280):
            page.resize(width, 844, is_phone=width < 900)
            fits = page.evaluate(
                "(() => { const box = document.getElementById('run-shown'), name ="
                " 'gather 0.3 m, 40 robots, with walls, variant fast, seed 1';"
                " box.replaceChildren(new Option(name)); const range = document.createElement("
                "'span'); range.textContent = name; range.style.font = getComputedStyle(box).font;"
                " range.style.position = 'absolute'; range.style.whiteSpace = 'nowrap';"
                " document.body.append(range); const wanted = range.offsetWidth; range.remove();"
                " return [wanted, box.clientWidth, box.getBoundingClientRect().right]; })()"
            )
            assert fits[2] <= width
            assert fits[1] >= min(fits[0], 0.8 * width)
        assert page.errors == []
