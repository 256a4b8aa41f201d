"""The floor of a world: patches, tiles and pictures, and what sensors read of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.settings.platforms import load_platform
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.floor import FloorField, Patch, drawn_tiles, floor_pixels
from swarmd.sim.world.scalar_fields import sample, with_readings
from swarmd.sim.world.world import World


def floor(*patches: Mapping[str, Any], colour: object = 1.0) -> FloorField:
    data = {"kind": "floor", "name": "ground", "colour": colour, "patches": patches}
    return msgspec.convert(data, FloorField)


def greys(field: FloorField, *places: tuple[float, float]) -> list[float]:
    return list(map(float, sample([field], np.array(places))["ground"]))


def test_a_patch_covers_what_is_in_its_shape() -> None:
    disc = floor({"disc": [1.0, 0.0, 0.5]})
    assert greys(disc, (1.0, 0.0), (1.4, 0.0), (1.6, 0.0)) == [0.0, 0.0, 1.0]
    turned = floor({"rectangle": [0.0, 0.0, 2.0, 0.2], "yaw_deg": 90.0, "colour": 0.5})
    assert greys(turned, (0.0, 0.9), (0.9, 0.0)) == [0.5, 1.0]
    notched = floor({"polygon": [[0, 0], [2, 0], [2, 2], [1, 0.5], [0, 2]]})
    assert greys(notched, (0.2, 1.0), (1.0, 1.0), (1.8, 1.0), (1.0, 0.2)) == [0.0, 1.0, 0.0, 0.0]


def test_a_later_patch_is_above_an_earlier_one() -> None:
    both = floor({"disc": [0, 0, 1], "colour": 0.2}, {"disc": [0, 0, 0.5], "colour": 0.7})
    assert greys(both, (0.0, 0.0), (0.8, 0.0), (2.0, 0.0)) == [0.7, 0.2, 1.0]


def test_tiles_have_exactly_their_share_and_the_places_of_their_seed() -> None:
    tiles = floor({"rectangle": [0, 0, 2, 2], "tiles": 0.1, "share": 0.55, "seed": 3})
    middles = (np.arange(20) + 0.5) / 10.0 - 1.0
    places = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
    values = tiles.at(places)
    assert (values == 0.0).sum() == 220
    np.testing.assert_array_equal(values == 0.0, drawn_tiles(400, 0.55, 3))
    assert (drawn_tiles(400, 0.55, 4) != drawn_tiles(400, 0.55, 3)).any()
    assert greys(tiles, (1.01, 0.0), (0.0, -1.01)) == [1.0, 1.0]


def test_a_coloured_floor_has_readings_of_its_colours() -> None:
    red = floor({"disc": [0, 0, 1], "colour": [1.0, 0.0, 0.0]})
    values = sample([red], np.array([[0.0, 0.0], [2.0, 0.0]]))
    assert values["ground"].tolist() == pytest.approx([0.299, 1.0])
    names = ("ground_red", "ground_green", "ground_blue")
    assert [values[name].tolist() for name in names] == [[1.0, 1.0], [0.0, 1.0], [0.0, 1.0]]
    assert list(sample([floor()], np.zeros((1, 2)))) == ["ground"]


def test_a_picture_lies_on_its_rectangle_with_its_top_at_the_highest_y(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image", reason="there is no Pillow")
    pixels = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    image.fromarray(pixels).save(tmp_path / "floor.png")
    patch = {"rectangle": [0, 0, 4, 2], "image": str(tmp_path / "floor.png")}
    at = np.array([[-1.0, 0.5], [1.0, 0.5], [-1.0, -0.5], [1.0, -0.5], [3.0, 0.0]])
    colours = floor(patch, colour=0.0).colours(at)
    assert colours.tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [0, 0, 0]]
    with pytest.raises(ConfigError, match=r"none\.png"):
        floor({**patch, "image": "none.png"}).check()
    image.new("1", (5000, 5000)).save(tmp_path / "large.png")
    with pytest.raises(ConfigError, match="5000 x 5000 pixels"):
        floor({**patch, "image": str(tmp_path / "large.png")}).check()


def test_a_picture_of_others_starts_no_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = pytest.importorskip("PIL.Image", reason="there is no Pillow")
    program = tmp_path / "gs"  # Ghostscript, which Pillow starts for PostScript
    program.write_text(f"#!/bin/sh\ntouch {tmp_path / 'canary'}\n")
    program.chmod(0o755)
    monkeypatch.setattr("PIL.EpsImagePlugin.gs_binary", str(program))
    picture = tmp_path / "floor.png"
    image.new("RGB", (2, 2)).save(picture, "EPS")
    with pytest.raises(ConfigError, match=r"floor\.png"):
        floor({"rectangle": [0, 0, 1, 1], "image": str(picture)}).check()
    assert not (tmp_path / "canary").exists()


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"disc": [0, 0, 1], "polygon": [[0, 0], [1, 0], [0, 1]]},
        {"disc": [0, 0, 1], "tiles": 0.1},
        {"rectangle": [0, 0, 1, 1], "tiles": 0.1, "image": "a.png"},
        {"rectangle": [0, 0, 100, 100], "tiles": 0.01},
        {"disc": [0, 0, 1], "colour": [1.0, 0.0]},
    ],
)
def test_a_patch_without_sense_is_refused(wrong: Mapping[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(wrong, Patch)


def test_a_robot_reads_the_floor_at_each_of_its_sensors() -> None:
    platform = replace(load_platform("turtlebot4"), sensors={})
    sensors = {"ground": np.array([[0.2, 0.1, math.nan], [0.2, -0.1, math.nan]])}
    equipped = replace(platform, sensors=sensors)
    half = floor({"rectangle": [-1.0, 0.0, 2.0, 4.0]})  # black on the left half
    starts = np.array([[-0.2, 0.0, math.pi / 2.0]])  # looks along y: sensor 1 at x -0.3, 2 at -0.1
    world = World({"a": equipped}, Arena(4.0, 4.0), starts, fields=[half])
    assert world.readings(0) == {"ground": 0.0, "ground_1": 0.0, "ground_2": 0.0}
    shifted = np.array([[0.05, 0.0, math.pi / 2.0]])
    world = World({"a": equipped}, Arena(4.0, 4.0), shifted, fields=[half])
    assert world.readings(0) == {"ground": 0.5, "ground_1": 0.0, "ground_2": 1.0}
    words = with_readings(equipped, [half]).provides - platform.provides
    assert words == {"reading:ground", "reading:ground_1", "reading:ground_2"}
    bare = replace(platform, sensors={})
    assert World({"a": bare}, Arena(4.0, 4.0), starts, fields=[half]).readings(0) == {"ground": 0.0}


def test_the_pixels_of_a_floor_begin_at_its_upper_left_corner() -> None:
    corner = floor({"rectangle": [-1.5, 0.5, 1.0, 1.0], "colour": 0.0})
    pixels = floor_pixels([corner], (4.0, 2.0), 8)
    assert pixels is not None
    assert pixels.shape == (4, 8, 3)
    assert (pixels[:2, :2] == 0).all()
    assert pixels.sum() == 255 * 3 * (32 - 4)
    assert floor_pixels([], (4.0, 2.0)) is None
