"""Arguments of `swarmctl exp plot`."""

from __future__ import annotations

import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.cli.exp_results import parse_kinds, parse_labels, parse_targets, parse_width


@pytest.mark.parametrize(
    ("text", "inches"), [("3.5in", 3.5), (" 89mm", 3.504), ("8.9 cm", 3.504), ("252pt", 3.487)]
)
def test_a_width_has_a_unit(text: str, inches: float) -> None:
    assert parse_width(text) == pytest.approx(inches, abs=1e-3)


@pytest.mark.parametrize("text", ["3.5", "in", "-3in", "1in", "100in", "3,5in"])
def test_other_widths_are_refused_with_an_example(text: str) -> None:
    with pytest.raises(ConfigError, match=r"3\.5in"):
        parse_width(text)


def test_targets_are_by_metric_whose_name_may_have_an_equals_sign() -> None:
    found = parse_targets(["gather_time=60", "report:state=wait=0.5"])
    assert found == {"gather_time": 60.0, "report:state=wait": 0.5}


@pytest.mark.parametrize("text", ["gather_time", "=3", "gather_time=soon"])
def test_other_targets_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="gather_time=60"):
        parse_targets([text])


def test_labels_are_by_name_and_may_hold_an_equals_sign() -> None:
    found = parse_labels(["range=lidar range [m]", "gather_time=t = 0 to gathered"])
    assert found == {"range": "lidar range [m]", "gather_time": "t = 0 to gathered"}


@pytest.mark.parametrize("text", ["range", "=x", "range= "])
def test_other_labels_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="lidar range"):
        parse_labels([text])


def test_pictures_that_do_not_exist_are_refused() -> None:
    assert parse_kinds("runs,intervals") == ("runs", "intervals")
    with pytest.raises(ConfigError, match="did you mean 'runs'"):
        parse_kinds("run")
