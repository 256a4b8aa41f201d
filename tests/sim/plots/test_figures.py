"""All pictures of an experiment's folder, and what is said of what cannot be drawn."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.experiments.compare import Side
from swarmd.sim.experiments.results import load_results
from swarmd.sim.plots.figures import KINDS, Look, compared_over_time, draw_experiment

pytest.importorskip("matplotlib")

OF_A_VARIANT = {
    *("runs.png", "typical_trajectories.png", "least_typical_trajectories.png"),
}
BOTH = {f"law-{law}_{name}" for law in ("settling", "paper") for name in OF_A_VARIANT}


def names(paths: list[Path]) -> set[str]:
    return {path.name for path in paths}


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records]


@pytest.mark.long
def test_all_is_drawn_and_a_damaged_and_a_missing_trace_are_one_line_each(
    experiment: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    traces = experiment / "traces"
    (traces / "law=paper_s0000.npz").write_bytes(b"PK\x03\x04 no longer a trace")
    (traces / "law=paper_s0001.npz").unlink()
    made = draw_experiment(
        experiment, tmp_path / "out", metrics=["mean_distance_to_centroid_end"],
        look=Look(only=KINDS),
    )  # fmt: skip
    left = {f"law-paper_{name}" for name in OF_A_VARIANT if name.startswith("least")}
    assert BOTH - names(made) == left  # one run of that variant is left, the typical one
    assert {"intervals.png", "over_time_mean_distance_to_centroid.png"} <= names(made)
    assert len(names(made)) == len(made)
    assert {path.parent for path in made} == {tmp_path / "out"}
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in made)
    told = sorted(warnings(caplog))
    assert len(told) == 2
    assert "law=paper_s0000.npz: not a trace" in told[0] + told[1]
    assert all(line.endswith("; the run is left out") for line in told)
    assert any(str(traces / "law=paper_s0001.npz") in line for line in told)


@pytest.mark.long
def test_one_run_has_no_worst_and_a_metric_of_one_value_is_not_drawn_and_named(
    experiment: Path, caplog: pytest.LogCaptureFixture
) -> None:
    metrics = ["minimum_gap", "failed_patterns"]
    made = draw_experiment(experiment, seeds=[1], metrics=metrics, look=Look(suffix=".svg"))
    assert {path.parent for path in made} == {experiment / "plots"}
    assert names(made) == {
        f"law-{law}_{name}.svg"
        for law in ("settling", "paper")
        for name in ("runs", "typical_trajectories")
    } | {"intervals.svg", "over_time_minimum_gap.svg"}
    assert warnings(caplog) == ["failed_patterns is 0 in all runs; it is not drawn"]


@pytest.mark.long
def test_pictures_name_scenario_variant_seed_and_value(
    experiment: Path, caplog: pytest.LogCaptureFixture
) -> None:
    made = draw_experiment(
        experiment, metrics=["minimum_gap"], seeds=[0, 2],
        look=Look(targets={"minimum_gap": 0.25}, suffix=".svg"),
    )  # fmt: skip
    texts = {path.name: path.read_text() for path in made}
    with (experiment / "runs.csv").open() as file:
        gaps = {row["run"]: float(row["minimum_gap"]) for row in csv.DictReader(file)}
    worst = min(("law=paper_s0000", "law=paper_s0002"), key=gaps.__getitem__)
    ways = texts["law-paper_worst_trajectories.svg"]
    assert f"gathering, law=paper, seed {int(worst[-4:])}" in ways
    assert f"worst run: minimum gap {gaps[worst]:.3g} m" in ways
    assert "target 0.25" in texts["over_time_minimum_gap.svg"]
    assert "m, target 0.25" in texts["intervals.svg"]
    assert "law=settling (n = 2)" in texts["intervals.svg"]
    assert f"seed 2: {gaps['law=paper_s0002']:.3g} m" in texts["law-paper_runs.svg"]
    assert warnings(caplog) == []


@pytest.mark.long
def test_without_traces_values_are_drawn_and_one_line_gives_the_reason(
    experiment: Path, caplog: pytest.LogCaptureFixture
) -> None:
    shutil.rmtree(experiment / "traces")
    intervals, differences = sorted(draw_experiment(experiment, look=Look(suffix=".svg")))[::-1]
    assert (intervals.name, differences.name) == ("intervals.svg", "differences.svg")
    assert "law=paper - law=settling" in differences.read_text()
    assert len(warnings(caplog)) == 1
    assert f"{experiment}: no traces were kept" in warnings(caplog)[0]


def test_an_unknown_metric_is_named_before_anything_is_drawn(experiment: Path) -> None:
    with pytest.raises(ConfigError, match="did you mean 'minimum_gap'"):
        draw_experiment(experiment, metrics=["minimum_gab"])
    assert not (experiment / "plots").exists()


@pytest.mark.parametrize(("seeds", "text"), [([7], "no finished run has seed 7"), ([], "no seed")])
def test_seeds_that_are_not_there_are_named(experiment: Path, seeds: list[int], text: str) -> None:
    with pytest.raises(ConfigError, match=f"{text}.*; there are 0, 1, 2"):
        draw_experiment(experiment, seeds=seeds)


def test_an_experiment_without_finished_runs_is_one_clear_error(experiment: Path) -> None:
    table = experiment / "runs.csv"
    table.write_text(table.read_text().splitlines()[0] + "\n")
    with pytest.raises(SwarmError, match=str(experiment)):
        draw_experiment(experiment)


def test_a_metric_without_any_value_leaves_the_first_run_to_be_drawn(experiment: Path) -> None:
    made = names(draw_experiment(experiment, metrics=["box_contacts"], seeds=[0]))
    assert {name.removeprefix("law-paper_") for name in made if "paper" in name} == {
        *("runs.png", "first_trajectories.png")
    }
    assert "intervals.png" not in made


def test_a_curve_over_time_of_one_variant_of_several_names_it(
    experiment: Path, tmp_path: Path
) -> None:
    for trace in (experiment / "traces").glob("law=paper_*"):
        trace.unlink()
    look = Look(suffix=".svg", only=("over_time",))
    (made,) = draw_experiment(experiment, tmp_path / "out", metrics=["minimum_gap"], look=look)
    assert "gathering, law=settling" in made.read_text()


def test_only_the_pictures_that_are_asked_for_are_drawn(experiment: Path, tmp_path: Path) -> None:
    made = names(draw_experiment(experiment, tmp_path / "all", metrics=["minimum_gap"]))
    assert not made & BOTH
    assert "intervals.png" in made
    look = Look(only=("runs",))
    assert names(draw_experiment(experiment, tmp_path / "runs", look=look)) == {
        "law-settling_runs.png",
        "law-paper_runs.png",
    }


def test_labels_name_metrics_and_swept_keys(experiment: Path, tmp_path: Path) -> None:
    look = Look(
        suffix=".svg",
        only=("intervals", "over_time"),
        labels={"minimum_gap": "smallest gap [cm]", "law": "rule"},
    )
    made = draw_experiment(experiment, tmp_path / "out", metrics=["minimum_gap"], look=look)
    texts = {path.name: path.read_text() for path in made}
    assert "smallest gap [cm]" in texts["over_time_minimum_gap.svg"]
    assert "rule=paper (n = 3)" in texts["intervals.svg"]
    with pytest.raises(ConfigError, match="did you mean 'law'"):
        draw_experiment(experiment, tmp_path / "no", look=Look(labels={"laws": "x"}))
    assert not (tmp_path / "no").exists()


def test_a_figure_of_a_paper_has_its_width_and_no_title(
    experiment: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    look = Look(suffix=".svg", width=3.5, facet="law")
    made = draw_experiment(
        experiment, tmp_path / "out", metrics=["minimum_gap"], seeds=[1], look=look
    )
    texts = {path.name: path.read_text() for path in made}
    assert all('width="252pt"' in text for text in texts.values())
    over_time = texts["over_time_minimum_gap.svg"]
    assert "law=settling" not in over_time
    assert "(a)" in over_time
    assert "(b)" in over_time
    assert "panels: (a) law=settling, (b) law=paper" in warnings(caplog)
    assert not any("gathering" in text and "line: median" in text for text in texts.values())


def test_a_facet_that_was_not_swept_is_named(experiment: Path) -> None:
    with pytest.raises(ConfigError, match="law"):
        draw_experiment(experiment, look=Look(facet="lawn"))


def test_variants_of_experiments_are_compared_over_time(experiment: Path) -> None:
    results = load_results(experiment)
    sides = {law: Side(law, results, f"law={law}") for law in ("paper", "settling")}
    figure = compared_over_time(sides, "minimum_gap", Look(width=3.5))
    (legend,) = figure.legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ["paper (n = 3)", "settling (n = 3)"]
    with pytest.raises(ConfigError, match="minimum_gap"):
        compared_over_time(sides, "minimum_gab")


def test_a_curve_needs_a_swept_number(experiment: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--facet"):
        draw_experiment(experiment, tmp_path / "out", look=Look(only=("curve",)))
