"""Films: frames, colours at the robots' places, captions, and what happens without ffmpeg."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, PluginError, SwarmError
from swarmd.core.values import Array
from swarmd.sim.film import encode
from swarmd.sim.film.colours import STATES, colouring_of, rgb_of
from swarmd.sim.trace import Trace
from swarmd.sim.view.trace_source import RecordedRun
from swarmd.sim.world.floor import FloorField
from tests.support.traces import trace_of

SIZE = (480, 360)
PLACES = np.array([[-1.5, 0.0], [0.0, 1.0], [1.5, -0.5]])
WORDS = ("running", "stopped", "estopped")


@pytest.fixture
def trace() -> Trace:
    """Three Waffle Pis that stand in an arena of 6 x 4 m for a second, each in its own state."""
    pose = np.zeros((11, 3, 3))
    pose[..., :2] = PLACES
    return trace_of(
        pose,
        platform="waffle_pi",
        ids=("a", "b", "c"),
        meta={"arena": "6x4"},
        state=np.broadcast_to(np.array(WORDS), (11, 3)),
        report={"opinion": np.tile([0.0, 1.0, np.nan], (11, 1))},
    )


def test_colours_by_state_and_by_opinion(trace: Trace) -> None:
    by_state = colouring_of(trace, "state")
    assert [tuple(rgb) for rgb in by_state.rgb[0].tolist()] == [rgb_of(STATES[w]) for w in WORDS]
    assert {word for _, word in by_state.key} == set(WORDS)
    by_opinion = colouring_of(trace, "opinion")
    assert [word for _, word in by_opinion.key] == ["opinion 0", "1"]
    assert len({tuple(rgb) for rgb in by_opinion.rgb[0].tolist()}) == 3
    with pytest.raises(ConfigError, match="opinion"):
        colouring_of(trace, "opinon")
    words = {"state": np.where(trace.state == "running", "wait", "turn")}
    reported = colouring_of(replace(trace, words=words), "report:state")
    assert {word for _, word in reported.key} <= {"wait", "turn"}


def test_a_pattern_has_its_colour_from_its_event_on(trace: Trace) -> None:
    events = [
        {"at": 0.0, "action": "run", "robots": ["a", "b", "c"], "pattern": "drive"},
        {"at": 0.5, "action": "run", "robots": ["b"], "pattern": "flocking"},
    ]
    found = colouring_of(replace(trace, meta={**trace.meta, "events": events}), "pattern")
    assert [word for _, word in found.key] == ["drive", "flocking"]
    assert (found.rgb[:5] == found.rgb[0, 0]).all()
    assert (found.rgb[5:, 1] != found.rgb[0, 0]).any(axis=1).all()


def test_a_film_without_ffmpeg_gives_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(PluginError, match="apt install ffmpeg"):
        encode.check_output(tmp_path / "a.mp4")
    with pytest.raises(ConfigError, match=r"\.gif"):
        encode.check_output(tmp_path / "a.avi")
    with pytest.raises(ConfigError, match="no folder"):
        encode.check_output(tmp_path / "none" / "a.mp4")


def test_a_machine_without_opengl_gives_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    from swarmd.sim.film import renderer

    def missing(name: str) -> None:
        tried.append(name)
        raise ImportError("no such library")

    tried: list[str] = []
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(renderer, "import_module", missing)
    with pytest.raises(PluginError, match="apt install libegl1"):
        renderer.gl_context(16, 16)
    assert tried == ["mujoco.egl", "mujoco.osmesa"]
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    with pytest.raises(ConfigError, match="egl or osmesa"):
        renderer.gl_context(16, 16)


needs_ffmpeg = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="there is no ffmpeg")


@pytest.mark.integration
@needs_ffmpeg
def test_a_film_that_fails_leaves_no_file(tmp_path: Path) -> None:
    black = np.zeros((SIZE[1], SIZE[0], 3), dtype=np.uint8)

    def interrupted() -> None:
        with encode.Encoder(tmp_path / "a.mp4", SIZE, 25) as encoder:
            encoder.write(black)
            raise KeyboardInterrupt

    def odd() -> None:
        with encode.Encoder(tmp_path / "a.mp4", (3, 3), 25) as encoder:
            encoder.write(black[:3, :3])  # H.264 needs even numbers

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with pytest.raises(SwarmError, match="ffmpeg"):
        odd()
    assert list(tmp_path.iterdir()) == []


def test_a_stage_has_the_floor_of_the_scenario(trace: Trace) -> None:
    from swarmd.sim.film.stage import stage_of

    black = FloorField(name="ground", colour=0.0)
    bare, floored = stage_of(trace, SIZE), stage_of(trace, SIZE, fields=[black])
    assert floored.model.ngeom == bare.model.ngeom + 1
    picture = floored.model.tex("picture").id
    first = floored.model.tex_adr[picture]
    assert not floored.model.tex_data[first:].any()


@needs_ffmpeg
@pytest.mark.integration
@pytest.mark.long
def test_a_film_of_a_second(trace: Trace, tmp_path: Path) -> None:
    from swarmd.sim.film.film import FilmSettings, make_film
    from swarmd.sim.film.renderer import gl_context

    pytest.importorskip("OpenGL", reason="there is no PyOpenGL")
    try:
        gl_context(16, 16).free()
    except PluginError as error:
        pytest.skip(str(error))
    path = tmp_path / "run.mp4"
    settings = FilmSettings(speed=1.0, size=SIZE, trail=0.0)
    gone = trace.pose.copy()
    gone[6:, 2] = np.nan
    assert make_film(RecordedRun(replace(trace, pose=gone)), path, "three robots", settings) == []
    assert _shape(path) == (*SIZE, 50)  # a second, and another in which the last frame stays
    first, last = _frame(path, 0), _frame(path, 49)
    scale = _scale(first)
    for place, word in zip(PLACES, WORDS, strict=True):
        # Behind the lidar; the bar that marks the front is white.
        x, y = _centre(first) + scale * np.array([place[0] - 0.14, -place[1]])
        around = first[round(y) - 1 : round(y) + 2, round(x) - 1 : round(x) + 2].reshape(-1, 3)
        assert np.abs(around.mean(axis=0) - rgb_of(STATES[word])).max() < 30.0, word
    x, y = _centre(last) + _scale(last) * np.array([PLACES[2, 0], -PLACES[2, 1]])
    assert last[round(y), round(x)].min() > 180  # the third robot has left; the floor is pale


@pytest.mark.parametrize(("most", "length"), [(1.9, 1.0), (2.0, 2.0), (0.07, 0.05), (70.0, 50.0)])
def test_a_scale_bar_has_a_round_length(most: float, length: float) -> None:
    from swarmd.sim.film.film import bar_length

    assert bar_length(most) == pytest.approx(length)


@pytest.mark.parametrize("arena", ["6x4", "4x4", "3x9"])
def test_frames_from_above_have_the_shape_of_the_arena(trace: Trace, arena: str) -> None:
    from swarmd.sim.film.film import Caption, frame_size
    from swarmd.sim.plots.scene import extent_of

    own = replace(trace, meta={"arena": arena})
    width, height = frame_size(own, SIZE, "top")
    extent = extent_of(own)
    picture = height - Caption((width, height), "", ()).height
    wanted = max(extent.width / extent.height, 0.8)  # a caption needs some width
    assert width / picture == pytest.approx(wanted, rel=0.05)
    assert width * height == pytest.approx(SIZE[0] * SIZE[1], rel=0.05)
    assert width % 2 == height % 2 == 0
    assert frame_size(own, SIZE, "perspective") == SIZE


@pytest.mark.integration
def test_frames_from_above_have_names_and_a_scale_bar(trace: Trace) -> None:
    from swarmd.sim.film.film import Marks, bar_length
    from swarmd.sim.film.renderer import Renderer
    from swarmd.sim.film.stage import stage_of

    pytest.importorskip("OpenGL", reason="there is no PyOpenGL")
    named = replace(trace, ids=("tb3-01", "tb3-02", "tb3-03"))
    try:
        renderer = Renderer(named, stage_of(named, SIZE), colouring_of(named, "state"), "top")
    except PluginError as error:
        pytest.skip(str(error))
    with renderer:
        scale = renderer.scale
        assert scale is not None
        marks = Marks(renderer, named.ids)
        assert marks.prefix == "tb3-"
        bare = renderer.frame(0.0)
        changes = np.abs(marks.onto(bare, 0.0).astype(int) - bare)
        difference = changes.max(axis=2) > 60
        reach = renderer.stage.reach * scale
        for x, y in renderer.pixels(0.0).tolist():
            left, right = round(x - reach), round(x + reach)
            assert difference[round(y - 3 * reach) : round(y - reach), left:right].any()
            assert not difference[round(y - reach / 2) : round(y + reach), left:right].any()
        longest = int(difference[SIZE[1] // 2 :].sum(axis=1).max())
        length = bar_length(0.2 * SIZE[0] / scale)
        assert longest == pytest.approx(length * scale, abs=8)  # with its pale edge
        middle = renderer.pixels(0.0)[1] - renderer.pixels(0.0)[0]
        assert middle == pytest.approx(scale * np.array([1.5, -1.0]))


def _shape(path: Path) -> tuple[int, int, int]:
    keys = "stream=width,height,nb_read_frames"
    done = subprocess.run(
        ["ffprobe", "-v", "error", "-count_frames", "-show_entries", keys, "-of", "json", path],
        capture_output=True,
        check=True,
    )
    (found,) = json.loads(done.stdout)["streams"]
    return found["width"], found["height"], int(found["nb_read_frames"])


def _frame(path: Path, number: int) -> Array:
    done = subprocess.run(
        ["ffmpeg", "-v", "error", "-i", path, "-vf", f"select=eq(n\\,{number})", "-frames:v", "1",
         "-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
        capture_output=True,
        check=True,
    )  # fmt: skip
    return np.frombuffer(done.stdout, dtype=np.uint8).reshape(SIZE[1], SIZE[0], 3).astype(float)


def _picture_height(frame: Array) -> int:
    """The rows above the caption, whose left margin is white."""
    return int(np.argmax((frame[:, :3] > 250.0).all(axis=(1, 2))))


def _centre(frame: Array) -> Array:
    return np.array([SIZE[0], _picture_height(frame)]) / 2.0


def _scale(frame: Array) -> float:
    """Pixels a m, from the distance of the dark walls: their inner sides are 6 m apart."""
    row = frame[_picture_height(frame) // 4, :, :].max(axis=1)
    dark = np.flatnonzero(row < 160.0)
    left, right = dark[dark < SIZE[0] / 2].max(), dark[dark > SIZE[0] / 2].min()
    return float(right - left) / 6.0
