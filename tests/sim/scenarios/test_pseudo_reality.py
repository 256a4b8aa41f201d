"""Pseudo-reality: each seed draws imperfections within bounds, the same for each scenario."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.pseudo_reality import BOUNDS, drawn, draws
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of
from tests.sim.conftest import write_duo


@pytest.mark.parametrize("seed", [0, 1, 77, 2**32 - 1])
def test_draws_lie_within_bounds_and_repeat(seed: int) -> None:
    found = draws(BOUNDS, seed)
    assert list(found) == list(BOUNDS)
    assert all(low <= found[key] <= high for key, (low, high) in BOUNDS.items())
    assert draws(BOUNDS, seed) == found
    assert draws({"radio.loss": BOUNDS["radio.loss"]}, seed)["radio.loss"] == found["radio.loss"]


def test_draws_fill_the_bounds_and_are_independent() -> None:
    loss, dropout = np.array(
        [[draws(BOUNDS, s)[k] for s in range(200)] for k in ("radio.loss", "realism.lidar.dropout")]
    )
    for values, high in ((loss, 0.3), (dropout, 0.1)):
        assert values.min() < 0.1 * high
        assert values.max() > 0.9 * high
    assert abs(np.corrcoef(loss, dropout)[0, 1]) < 0.25  # 3.5 standard errors


def test_a_scenario_gets_what_its_seed_draws() -> None:
    scenario = load_scenario("dispersion", {"pseudo_reality": True})
    values = draws(BOUNDS, 3)
    found = drawn(scenario, 3)
    assert found.radio.loss == values["radio.loss"]
    assert found.realism.lidar.dropout == values["realism.lidar.dropout"]
    assert found.realism.actuation.delay == values["realism.actuation.delay"]
    assert found.realism.lidar.rolling == scenario.realism.lidar.rolling
    assert drawn(scenario, 4).radio.loss != found.radio.loss
    assert drawn(found, 3).realism == found.realism
    nominal = load_scenario("dispersion")
    assert drawn(nominal, 3) is nominal


def test_a_run_has_the_draws_of_its_seed_and_repeats(tmp_path: Path) -> None:
    bounds = {"realism.actuation.delay": [0.2, 0.4], "radio.loss": [0.1, 0.2]}
    sets = {"pseudo_reality": bounds, "duration": 1.0}
    scenario = load_scenario(write_duo(tmp_path), sets)
    again = scenario_of(scenario.effective)
    first, second, other = simulate_run(scenario, 1), simulate_run(again, 1), simulate_run(again, 2)
    assert first.meta["pseudo_reality"] == draws(scenario.pseudo_reality, 1)
    assert first.meta["radio"]["loss"] == first.meta["pseudo_reality"]["radio.loss"]
    np.testing.assert_array_equal(first.pose, second.pose)
    assert other.meta["pseudo_reality"] != first.meta["pseudo_reality"]
    nominal = simulate_run(load_scenario(write_duo(tmp_path / "n"), {"duration": 1.0}), 1)
    moved = [np.ptp(trace.pose[:, 0, 0]) for trace in (nominal, first)]
    assert moved[1] < moved[0]  # it begins to move 0.2 to 0.4 s later


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({"realism.lidar.dropot": [0, 0.1]}, "did you mean 'realism.lidar.dropout'"),
        ({"realism.lidar.rolling": [0, 1]}, "no key 'realism.lidar.rolling'"),
        ({"radio.loss": [0, 1.5]}, "pseudo_reality: a bound is refused: .*1.0"),
        ({"radio.loss": [0.3, 0.1]}, "radio.loss: 0.3 is above 0.1"),
        ({"radio.loss": 0.3}, r"radio.loss: is 0.3; expected the bounds, such as \[0, 0.1\]"),
        ({"radio.loss": [0, float("nan")]}, "radio.loss: is"),
        ({"radio.jitter": [0, 0.1]}, "radio.jitter is 0.1; expected at most radio.delay"),
    ],
)
def test_wrong_bounds_are_named(bounds: object, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as raised:
        load_scenario("dispersion", {"pseudo_reality": bounds})
    assert str(raised.value).startswith("--set: pseudo_reality: ")
    assert "\n" not in str(raised.value)
