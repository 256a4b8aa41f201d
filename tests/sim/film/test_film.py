"""Films: frames, colours at the robots' places, captions, and what happens without ffmpeg."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.text import Text

from swarmd.core.errors import ConfigError, PluginError, SwarmError
from swarmd.core.values import Array
from swarmd.sim.film import encode
from swarmd.sim.film.colours import STATES, colouring_of
from swarmd.sim.film.film import Drawing, FilmSettings, frame_size, make_film, title_of
from swarmd.sim.plots.scene import Extent, robot_colour
from swarmd.sim.trace import Trace
from swarmd.sim.view.trace_source import RecordedRun
from tests.support.traces import trace_of

SIZE = (480, 360)
EXTENT = Extent(-3.2, 3.2, -2.4, 2.4)
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
        meta={"arena": "6x4.5"},
        state=np.broadcast_to(np.array(WORDS), (11, 3)),
        report={"opinion": np.tile([0.0, 1.0, np.nan], (11, 1))},
    )


def test_the_fault_of_a_robot_stands_beside_its_name_while_it_is_on(trace: Trace) -> None:
    events = [
        {"at": 0.2, "action": "fault scan frozen", "robots": ["b"]},
        {"at": 0.8, "action": "mend scan frozen", "robots": ["b"]},
    ]
    faulty = replace(trace, meta={**trace.meta, "events": events})
    drawing = Drawing(faulty, colouring_of(faulty, "state"), SIZE, EXTENT, title="title")

    def words(time: float) -> set[str]:
        drawing.at(time)
        return {text.get_text() for text in drawing.figure.findobj(Text)}

    assert {"a", "b", "c"} <= words(0.1)
    assert {"a", "b: scan frozen", "c"} <= words(0.5)
    assert {"a", "b", "c"} <= words(0.9)


def test_colours_by_state_and_by_opinion(trace: Trace) -> None:
    by_state = colouring_of(trace, "state")
    assert by_state.colours[0].tolist() == [STATES[word] for word in WORDS]
    assert {word for _, word in by_state.key} == set(WORDS)
    by_opinion = colouring_of(trace, "opinion")
    assert [word for _, word in by_opinion.key] == ["opinion 0", "1"]
    assert len({*by_opinion.colours[0].tolist()}) == 3
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
    assert (found.colours[:5] == found.colours[0, 0]).all()
    assert (found.colours[5:, 1] != found.colours[0, 0]).all()


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


needs_ffmpeg = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="there is no ffmpeg")


@pytest.mark.integration
@needs_ffmpeg
def test_a_film_that_fails_leaves_no_file(tmp_path: Path) -> None:
    black = bytes(3 * SIZE[0] * SIZE[1])

    def interrupted() -> None:
        with encode.encoder(tmp_path / "a.mp4", SIZE, 25) as write:
            write(black)
            raise KeyboardInterrupt

    def odd() -> None:
        with encode.encoder(tmp_path / "a.mp4", (3, 3), 25) as write:
            write(bytes(27))  # H.264 needs even numbers

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with pytest.raises(SwarmError, match="ffmpeg"):
        odd()
    assert list(tmp_path.iterdir()) == []


def test_robots_are_drawn_at_their_places_in_their_colours(trace: Trace) -> None:
    gone = trace.pose.copy()
    gone[6:, 2] = np.nan
    drawing = Drawing(replace(trace, pose=gone), colouring_of(trace, "state"), SIZE, EXTENT)
    first, last = drawing.at(0.0).astype(float), drawing.at(1.0).astype(float)
    assert first.shape == (SIZE[1], SIZE[0], 3)
    for place, word in zip(PLACES, WORDS, strict=True):
        around = _around(first, place - (0.14, 0.0))  # behind the line from the axle to the front
        assert np.abs(around - to_rgb(STATES[word])).max() < 0.05, word
    assert _around(last, PLACES[2]).min() > 0.95  # the third robot has left
    assert (_around(last, PLACES[1]) == _around(first, PLACES[1])).all()


def test_a_robot_between_two_instants_has_a_trail(trace: Trace) -> None:
    pose = trace.pose.copy()
    pose[:, 0, 0] += 3.0 * trace.t  # 3 m in a second, to the right
    drawing = Drawing(replace(trace, pose=pose), colouring_of(trace, "robot"), SIZE, EXTENT)
    at, past = PLACES[0] + (0.75, 0.0), PLACES[0] + (0.45, 0.0)
    bare, trailed = drawing.at(0.25) / 255.0, drawing.at(0.25, trail=0.2) / 255.0
    own = np.array(to_rgb(robot_colour(0)))
    assert np.abs(_around(255.0 * bare, at - (0.14, 0.0)) - own).max() < 0.05
    x, y = _pixel(past)
    assert bare[y, x].min() > 0.95
    assert np.abs(trailed[y, x] - (own + 1.0) / 2.0).max() < 0.1  # half of its colour


def test_texts_around_the_map(trace: Trace) -> None:
    named = replace(trace, ids=("tb3-01", "tb3-02", "tb3-03"))
    drawing = Drawing(named, colouring_of(trace, "opinion"), SIZE, EXTENT, (), "a title", "4x")
    drawing.at(0.3)
    texts = {text.get_text() for text in drawing.figure.findobj(Text)}
    assert {"01", "02", "03", "0.3 s: a title", "4x", "opinion 0", "1"} <= texts


def test_a_title_names_the_scenario_or_else_the_pattern(trace: Trace) -> None:
    assert title_of(replace(trace, meta={"scenario": "duo", "seed": 2})) == "duo, seed 2"
    plain = replace(trace, meta={"scenario": "", "seed": 0, "pattern": "drive"})  # of a demo
    assert title_of(plain) == "drive 3 waffle_pi"


def test_small_robots_are_enlarged_at_most_twice(trace: Trace) -> None:
    wide = Extent(-32.0, 32.0, -24.0, 24.0)  # 7.5 pixels a m; a robot has 4 pixels
    drawing = Drawing(trace, colouring_of(trace, "state"), SIZE, wide, (), "", "4x")
    assert "4x; robots enlarged 2.0x" in {t.get_text() for t in drawing.figure.findobj(Text)}


@needs_ffmpeg
@pytest.mark.integration
@pytest.mark.long
def test_a_film_of_a_second(trace: Trace, tmp_path: Path) -> None:
    path = tmp_path / "run.mp4"
    settings = FilmSettings(speed=1.0, size=SIZE[0], trail=0.0)
    gone = trace.pose.copy()
    gone[6:, 2] = np.nan
    make_film(RecordedRun(replace(trace, pose=gone)), path, "three robots", settings)
    # 6.24 m x 4.74 m with the margin; a second, and another in which the last frame stays
    assert _shape(path) == (480, 364, 50)
    red = np.array(to_rgb(STATES["estopped"])) * 255.0
    reds = [(np.abs(_frame(path, n) - red).max(axis=2) < 30.0).sum() for n in (0, 49)]
    assert reds[0] > 2 * reds[1] > 0  # the key alone has the colour of the robot that left


@pytest.mark.parametrize(
    ("sides", "size"),
    [((4.0, 2.0), (480, 240)), ((2.0, 2.0), (480, 480)), ((1.0, 4.0), (384, 480))],
)
def test_frames_have_the_shape_of_the_arena(
    sides: tuple[float, float], size: tuple[int, int]
) -> None:
    assert frame_size(Extent(0.0, sides[0], 0.0, sides[1]), 480) == size  # at least 0.8 as wide


def _pixel(place: Array) -> tuple[int, int]:
    """Column and row of a place in a picture of EXTENT without texts."""
    x, y = np.array(SIZE) / 2.0 + 75.0 * place * (1.0, -1.0)  # 75 pixels a m
    return round(x), round(y)


def _around(frame: Array, place: Array) -> Array:
    """The mean colour of 3 x 3 pixels around a place, from 0 to 1."""
    x, y = _pixel(place)
    mean: Array = frame[y - 1 : y + 2, x - 1 : x + 2].reshape(-1, 3).mean(axis=0) / 255.0
    return mean


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
    return np.frombuffer(done.stdout, dtype=np.uint8).reshape(364, 480, 3).astype(float)
