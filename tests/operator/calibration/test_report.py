"""Figures as settings: to the safe side, as a platform file that loads."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from swarmd.core.values import Sweep
from swarmd.operator.calibration.figures import Figure, SweepFigure, names_of
from swarmd.operator.calibration.report import figures_of, measured_file, platform_file, settings
from swarmd.settings.settings import load_platform

GOOD = {
    "braking_linear": Figure(1.6, 0.05, 8, 1.0),
    "braking_angular": Figure(4.0, 0.1, 8, 3.0),
    "reaction_linear": Figure(0.03, 0.002, 16, 0.05),
    "reaction_angular": Figure(0.03, 0.002, 16, 0.05),
    "odometry_age": Figure(0.025, 0.014, 3000),
    "speed_linear": Figure(1.0, 0.005, 8, 1.0),
    "speed_angular": Figure(1.0, 0.005, 8, 1.0),
    "odometry_linear": Figure(assumed=1.0, why="a bare corridor"),
    "odometry_angular": Figure(1.0, 0.001, 45, 1.0),
    "scan_delay": Figure(0.06, 0.01, 45, 0.1),
    "margin": Figure(0.03, 0.0, 32, 0.03),
}
SIDEWAYS = {
    **GOOD,
    "braking_lateral": Figure(1.4, 0.1, 8, 1.0),
    "reaction_lateral": Figure(0.03, 0.002, 16, 0.05),
    "speed_lateral": Figure(1.0, 0.005, 8, 1.0),
    "odometry_lateral": Figure(1.0, 0.01, 16, 1.0),
}
"""Of a base that moves sideways."""
DROVE = 0.22, 2.1


def loaded(folder: Path, figures: dict[str, Figure]) -> tuple[str, dict[str, float]]:
    """The text of the file, and what it sets."""
    file = folder / "mine.yaml"
    text = platform_file("r01", "burger", "2026-01-01", figures, settings(figures, DROVE))
    file.write_text(text)
    platform = load_platform(str(file))
    barrier = platform.protection["barrier"]
    values = {key: barrier[key] for key in ("braking_linear", "braking_angular", "margin")}
    return text, {
        **values,
        "latency": platform.scan.latency,
        "linear": platform.limits.linear,
        "angular": platform.limits.angular,
    }


def test_what_is_less_careful_is_left_to_the_user(tmp_path: Path) -> None:
    text, values = loaded(tmp_path, GOOD)
    assert values == {
        **{"braking_linear": 1.0, "braking_angular": 3.0, "margin": 0.03},
        **{"latency": 0.1, "linear": 0.22, "angular": 2.84},
    }
    commented = [line for line in text.splitlines() if line.startswith("#     braking_")]
    assert len(commented) == 2
    assert "braking_linear: 1.5 " in commented[0]  # mean less 2 sd


@pytest.mark.parametrize(
    ("found", "sweep", "is_unknown"),
    [
        (SweepFigure(why="too few turns"), None, True),
        (SweepFigure("null", 20), None, False),
        (
            SweepFigure("{start_deg: -90, direction: cw, duration: 0.1}", 20),
            Sweep(-0.5 * math.pi, -1.0, 0.1),
            False,
        ),
    ],
)
def test_measured_sweep_is_written(
    tmp_path: Path, found: SweepFigure, sweep: Sweep | None, is_unknown: bool
) -> None:
    (tmp_path / "open.yaml").write_text("description: x\nextends: burger\nscan: {sweep: unknown}\n")
    text = platform_file("r01", "./open.yaml", "2026-01-01", GOOD, settings(GOOD, DROVE, found))
    (tmp_path / "mine.yaml").write_text(text)
    scan = load_platform(str(tmp_path / "mine.yaml")).scan
    assert (scan.sweep, scan.is_sweep_unknown) == (sweep, is_unknown)


def test_what_is_more_careful_is_set(tmp_path: Path) -> None:
    weak = {
        **GOOD,
        "braking_linear": Figure(0.6, 0.02, 8, 1.0),
        "braking_angular": Figure(3.1, 0.2, 8, 3.0),
        "speed_linear": Figure(0.9, 0.005, 8, 1.0),
        "scan_delay": Figure(0.14, 0.01, 45, 0.1),
        "margin": Figure(0.0712, 0.0, 32, 0.03),
    }
    _, values = loaded(tmp_path, weak)
    assert values == pytest.approx(
        {
            **{"braking_linear": 0.56, "braking_angular": 2.7, "margin": 0.072},
            **{"latency": 0.16, "linear": 0.198, "angular": 2.84},
        }
    )


@pytest.mark.parametrize(
    ("linear", "lateral", "value", "is_safe"),
    [
        (1.6, Figure(1.4, 0.1, 8, 1.0), 1.2, False),
        (0.9, Figure(1.4, 0.1, 8, 1.0), 0.9, True),
        (1.6, Figure(0.6, 0.0, 8, 1.0), 0.6, True),
        (0.6, Figure(0.6, 0.0, 8, 1.0), 0.6, True),
        (0.9, Figure(assumed=1.0, why="scatter"), 0.9, True),
        (1.6, Figure(assumed=1.0, why="scatter"), None, None),  # nothing is known of the weaker
    ],
)
def test_the_braking_is_that_of_the_weakest_direction(
    linear: float, lateral: Figure, value: float | None, is_safe: bool | None
) -> None:
    figures = {
        **SIDEWAYS,
        "braking_linear": Figure(linear, 0.0, 8, 1.0),
        "braking_lateral": lateral,
        "speed_lateral": Figure(0.9, 0.005, 8, 1.0),
    }
    chosen = {one.key: one for one in settings(figures, (*DROVE, 0.2))}
    assert chosen["limits.lateral"].value == pytest.approx(0.18)
    braking = chosen.get("protection.barrier.braking_linear")
    found = (None, None) if braking is None else (braking.value, braking.is_safe)
    assert found == (value, is_safe)


def test_a_file_of_a_base_that_moves_sideways_loads(tmp_path: Path) -> None:
    weak = {
        **SIDEWAYS,
        "braking_lateral": Figure(0.6, 0.02, 8, 0.8),
        "speed_lateral": Figure(0.9, 0.005, 8, 1.0),
    }
    chosen = settings(weak, (0.76, 3.1, 0.76))
    file = tmp_path / "mine.yaml"
    file.write_text(platform_file("r01", "rosbot_xl", "2026-01-01", weak, chosen))
    platform = load_platform(str(file))
    assert platform.protection["barrier"]["braking_linear"] == 0.56
    assert (platform.limits.linear, platform.limits.lateral) == (0.8, 0.684)


@pytest.mark.parametrize("figures", [GOOD, SIDEWAYS])
def test_a_figure_survives_the_report(figures: dict[str, Figure]) -> None:
    report = {name: figure.text for name, figure in figures.items()}
    assert all(len(text) <= 256 for text in report.values())
    back = figures_of(report)
    assert back.keys() == figures.keys()
    for name, figure in figures.items():
        assert back[name].why == figure.why
        assert back[name].samples == figure.samples
        assert back[name].value == pytest.approx(figure.value, nan_ok=True)
        assert math.isnan(back[name].assumed) == math.isnan(figure.assumed)


def test_a_report_of_another_pattern_is_refused() -> None:
    with pytest.raises(ValueError, match="braking_linear"):
        figures_of({"state": "straight"})
    report = {name: figure.text for name, figure in GOOD.items()}
    with pytest.raises(ValueError, match="braking_lateral"):
        figures_of({**report, "speed_lateral": SIDEWAYS["speed_lateral"].text})


def test_the_file_has_a_line_for_each_figure_and_for_a_sweep_that_was_not_measured() -> None:
    why = SweepFigure(why="too few turns")
    given = {name: figure.text for name, figure in SIDEWAYS.items()}
    report = {**given, "sweep": why.text, "drove": "0.22 2.1 0.2"}
    lines = measured_file("r01", "burger", "2026-01-01", report).splitlines()
    comments = [line.removeprefix("#   ") for line in lines if line.startswith("#   ")]
    assert comments[0] == "braking, linear: 1.6 +- 0.05 (8) m/s2; assumed 1"
    assert "odometry / scan, linear: not measured: a bare corridor" in comments
    assert "scan.sweep: not measured: too few turns" in comments
    assert len(names_of(True)) == 14
    assert len([line for line in comments if "+-" in line or "not measured" in line]) >= 14 + 1
    assert "extends: burger" in lines
    assert "extends: ./own.yaml" in measured_file("r01", "own", "2026-01-01", report)
