"""The distance from walls at which each platform may be set down, by the table of its page."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.operator.texts.values import centimetres
from swarmd.robot.protection.modes import make_mode, narrowest_passage
from swarmd.robot.protection.set_down import set_down
from swarmd.settings.platforms import load_platform

ROBOTS = Path(__file__).parents[3] / "docs" / "robots"
# docs/robots/README.md: m from walls, m around the lidar.
PAGE = [
    ("burger", "0.20 m", None),
    ("waffle_pi", "0.34 m", None),
    ("turtlebot4", "0.40 m", None),
    ("rosbot_xl", "0.45 m", None),
    ("jackal", "0.74 m", 0.92),
    ("crazyflie", "0.34 m", None),
]


@pytest.mark.parametrize(("name", "gap", "lidar"), PAGE)
def test_each_platform_names_its_distance(name: str, gap: str, lidar: float | None) -> None:
    platform = load_platform(name)
    found = set_down(platform, narrowest_passage(make_mode(platform)))
    assert found is not None
    assert (centimetres(found.gap), found.lidar) == (gap, lidar)


@pytest.mark.parametrize(("name", "gap", "lidar"), PAGE)
def test_the_page_of_each_robot_names_it(name: str, gap: str, lidar: float | None) -> None:
    page = (ROBOTS / f"{name}.md").read_text()
    assert f"{gap} from walls" in page
    assert lidar is None or f"{lidar:.2f} m of its lidar" in page


@pytest.mark.parametrize("name", ["epuck2", "thymio"])
def test_other_modes_have_no_such_distance(name: str) -> None:
    platform = load_platform(name)
    assert set_down(platform, narrowest_passage(make_mode(platform))) is None
