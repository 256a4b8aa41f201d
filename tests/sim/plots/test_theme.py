"""Pictures appear whole, or not at all with one clear line."""

from __future__ import annotations

import builtins
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.plots.intervals import Panel, intervals_figure
from swarmd.sim.plots.survival import Times, survival_figure
from swarmd.sim.plots.theme import in_order, new_figure, save, variant_style, variant_styles

pytest.importorskip("matplotlib")


@pytest.mark.parametrize(
    ("suffix", "start"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")]
)
def test_the_suffix_selects_the_format(tmp_path: Path, suffix: str, start: bytes) -> None:
    path = tmp_path / "deep" / f"x{suffix}"
    assert save(new_figure(3.0, 2.0), path) == path
    assert path.read_bytes().startswith(start)
    assert list(path.parent.iterdir()) == [path]


def test_text_beside_a_figure_is_not_cut(tmp_path: Path) -> None:
    from matplotlib.image import imread

    def pixels(name: str, x: float) -> tuple[int, ...]:
        figure = new_figure(3.0, 2.0)
        figure.add_subplot()
        figure.text(x, 0.5, "beside")
        return tuple(imread(save(figure, tmp_path / f"{name}.png")).shape)

    assert pixels("out", 1.1)[1] > pixels("in", 0.5)[1] + 40


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_the_same_figure_gives_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    def draw(name: str) -> bytes:
        figure = new_figure(3.0, 2.0)
        figure.add_subplot().fill([0, 1, 1], [0, 0, 1], clip_on=True)
        return save(figure, tmp_path / f"{name}{suffix}").read_bytes()

    assert draw("a") == draw("b")


def test_another_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"x\.bmp.*\.png"):
        save(new_figure(3.0, 2.0), tmp_path / "x.bmp")


def test_without_matplotlib_the_error_names_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(SwarmError, match=r"pip install 'swarmd\[plot\]'"):
        new_figure(3.0, 2.0)


@pytest.mark.parametrize("error", [ValueError("no backend 'nonsense'"), PermissionError("rc")])
def test_settings_of_the_user_that_stop_the_import_are_one_line(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """`$MPLBACKEND` of a user counts in a program of the user; a verb ignores it."""

    def fail(name: str, *more: Any) -> Any:
        if name == "matplotlib":
            raise error
        return real_import(name, *more)

    real_import = builtins.__import__
    monkeypatch.setattr(builtins, "__import__", fail)
    with pytest.raises(SwarmError, match="MPLBACKEND") as refused:
        new_figure(3.0, 2.0)
    assert "\n" not in str(refused.value)


VERB = """
import sys
from pathlib import Path
from swarmd.sim.cli.options import need
need("matplotlib")
from swarmd.sim.plots.theme import new_figure, save
figure = new_figure(3.0, 2.0)
figure.add_subplot().set_title("title")
save(figure, Path(sys.argv[1]))
"""


@pytest.mark.integration
@pytest.mark.long
def test_a_verb_draws_without_backend_and_style_of_the_user(tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\n")
    of_user = {"MPLBACKEND": "nonsense", "MATPLOTLIBRC": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", VERB, tmp_path / "x.png"],
        env={**os.environ, **of_user},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "x.png").exists()


@pytest.mark.parametrize("in_the_way", ["taken", "taken/x.png/folder"])
def test_a_picture_that_cannot_be_written_leaves_nothing(tmp_path: Path, in_the_way: str) -> None:
    blocked = tmp_path / in_the_way
    blocked.parent.mkdir(parents=True, exist_ok=True)
    blocked.write_text("")
    with pytest.raises(SwarmError, match=r"taken/x\.png"):
        save(new_figure(3.0, 2.0), tmp_path / "taken" / "x.png")
    assert not list(tmp_path.rglob("*.partial"))


def test_a_swept_number_has_the_colours_of_a_scale_in_its_order() -> None:
    values = ["2.0", "0.5", "1.0"]
    assert in_order(values) == ["0.5", "1.0", "2.0"]
    assert in_order(["b", "1.0", "a"]) == ["b", "1.0", "a"]
    dark, middle, light = (
        sum(int(colour[at : at + 2], 16) for at in (1, 3, 5))
        for colour, _ in variant_styles(in_order(values))
    )
    assert dark < middle < light
    assert variant_styles(values)[1] == variant_styles(in_order(values))[0]
    words = ["law=a", "law=b", "law=c"]
    assert variant_styles(words) == [variant_style(index) for index in range(3)]
    assert variant_styles(["1.0", "2.0"]) == [variant_style(0), variant_style(1)]


def test_rows_and_legends_are_in_the_order_of_a_swept_number() -> None:
    values = {name: (0.1, 0.2, 0.3) for name in ("2.0", "0.5", "1.0")}
    axes = intervals_figure([Panel(label="gap", values=values)]).axes[0]
    assert [one.get_text()[:3] for one in axes.get_yticklabels()] == ["0.5", "1.0", "2.0"]
    times = {name: Times(np.array([1.0, 2.0]), np.full(2, 9.0)) for name in values}
    figure = survival_figure({"": times}, event="gathering")
    assert [one.get_text()[:3] for one in figure.legends[0].get_texts()] == ["0.5", "1.0", "2.0"]
