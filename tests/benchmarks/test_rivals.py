"""What the tables beside other simulators say, and what a cell runs."""

from __future__ import annotations

import sys
from xml.etree import ElementTree

import pytest

from benchmarks.rivals.__main__ import (
    Command,
    Missing,
    Simulator,
    cell,
    main,
    measured,
    programs,
    sample,
)
from benchmarks.rivals.argos_steps import world
from benchmarks.rivals.swarmd_steps import measure, overrides
from studies.night.jobs import JOBS
from studies.night.sources import ROOT, sources_of


def test_a_cell_has_the_median_speed_and_its_ratio_within_each_round() -> None:
    # The second round was measured on a machine that was half as fast.
    own = [(100.0, 1.0), (50.0, 1.0), (100.0, 1.0)]
    other = [(300.0, 1.0), (150.0, 1.0), (800.0, 2.0)]

    assert cell(own, other) == "300 (3 x, 3 to 4)"
    assert cell(own, own) == "100 (50 to 100)"


def test_a_round_without_a_sample_gives_no_ratio() -> None:
    assert cell([(100.0, 1.0), (100.0, 1.0)], [(200.0, 1.0), None]) == "200 (2 x, 2 to 2)"
    assert cell([(100.0, 1.0)], [None]) == "-"


def test_a_simulator_that_is_missing_is_named_with_the_remedy_and_the_others_stay() -> None:
    def absent() -> Command:
        raise Missing("no argos3; give ARGOS=/prefix")

    there = Simulator("here", "", lambda: ("true",))
    found, missing = programs((Simulator("absent", "", absent), there))

    assert found == {"here": ("true",)}
    assert missing == ["absent is left out: no argos3; give ARGOS=/prefix."]


def test_a_simulator_of_another_name_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        main(["--only", "Gazebo"])

    assert refused.value.code == 2
    assert "ARGoS" in capsys.readouterr().err  # one of the names to choose from


def test_what_failed_once_is_not_tried_again_nor_with_more_robots_or_rays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ran: list[str] = []

    def fail(command: Command) -> None:
        ran.append(command[1])

    monkeypatch.setattr("benchmarks.rivals.__main__.sample", fail)
    one = Simulator("one", "", lambda: ("one",))
    samples = measured([one], {"one": ("one",)}, (7, 100), (24, 360), rounds=2, seconds=1.0)

    assert ran == ["7"]
    assert samples["one", 100, 360] == [None, None]


@pytest.mark.integration
def test_a_program_that_fails_or_takes_too_long_gives_no_sample(
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert sample((sys.executable, "-c", "print('greeting'); print(12.5, 0.5)")) == (12.5, 0.5)
    assert sample((sys.executable, "-c", "while True: pass"), limit=1) is None
    assert sample((sys.executable, "-c", "raise SystemExit('no torch')")) is None
    said = capfd.readouterr().err.splitlines()
    assert ["1 CPU-s" in said[0], "no torch" in said[1]] == [True, True]


@pytest.mark.parametrize(("rays", "mode"), [(8, "barrier"), (360, "off")])
def test_swarmd_steps_robots_with_these_rays(rays: int, mode: str) -> None:
    simulated, taken = measure(2, 1e-4, overrides(2, rays, 1.2, 0.5, mode))

    assert simulated >= 2 * 0.1  # a step
    assert taken > 0.0


def test_the_world_of_argos_is_well_formed() -> None:
    tree = ElementTree.fromstring(world("/lib.so", 100, 1.0))

    assert [one.get("quantity") for one in tree.iter("entity")] == ["100"]


def test_the_night_makes_the_tables_again_after_a_change_of_a_program() -> None:
    (job,) = (one for one in JOBS if one.name == "rivals")
    folder = ROOT / "benchmarks" / "rivals"
    stems = {path.stem for path in folder.iterdir() if path.suffix in (".cpp", ".py")}

    assert {name.rpartition(".")[2] for name in job.modules} == stems
    (enki,) = sources_of(["benchmarks.rivals.enki_steps"])
    assert enki == folder / "enki_steps.cpp"
