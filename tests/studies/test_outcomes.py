"""Every pattern reaches its outcomes: one short run in the suite, several in `make evidence`."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from studies.night.jobs import JOBS
from studies.outcomes import outcome, still
from studies.outcomes.__main__ import main
from studies.outcomes.catalog import MODULES
from studies.outcomes.outcome import (
    SHORT_SEED,
    Outcome,
    at_least,
    at_most,
    digits_of,
    other_digits,
    renewal,
    reported,
)
from swarmd.core.pin import pinned_environment

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]
KEPT = outcome.kept_outcomes()


def missed(outcomes: Sequence[Outcome]) -> list[str]:
    """What is missed and is not kept as missed."""
    return [
        f"{o.what}: {o.shown}; expected {o.wanted}"
        for o in outcomes
        if not o.is_reached and o.what not in KEPT[o.pattern].missed
    ]


@pytest.fixture(scope="module")
def short_forms() -> Iterator[subprocess.Popen[str]]:
    """A pinned process that answers with the short form of each pattern."""
    with subprocess.Popen(
        [sys.executable, "-m", "studies.outcomes.short"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env=pinned_environment(),
    ) as process:
        yield process
        assert process.stdin is not None
        process.stdin.close()


@pytest.mark.integration
@pytest.mark.parametrize(
    "pattern",
    [
        pytest.param(name, marks=[pytest.mark.evidence] * getattr(module, "IS_LONG", False))
        for name, module in MODULES.items()
    ],
)
def test_one_run_reaches_every_outcome_with_the_kept_digits(
    pattern: str, short_forms: subprocess.Popen[str]
) -> None:
    """In its short form. IS_LONG: two seconds of processor time and more, or run by another test;
    tests/patterns has its rules, and tests/sim/lockstep/test_matrix.py runs it in a swarm.

    A pinned run repeats bit by bit on any x86-64 with the same libraries, so any other digit shows
    that the table is old. With another C library the last digits differ, and soon all: there a
    small tolerance would fail, and a large one would show nothing. So digits are compared with the
    libraries of the file alone, and elsewhere only the bounds."""
    assert short_forms.stdin is not None
    assert short_forms.stdout is not None
    print(pattern, file=short_forms.stdin, flush=True)
    answer = json.loads(short_forms.stdout.readline())
    outcomes = msgspec.convert(answer["outcomes"], tuple[Outcome, ...])
    assert len(outcomes) >= 2
    assert missed(outcomes) == []
    machine = KEPT[pattern].other_machine_of_short(answer["software"])
    if machine is not None:
        pytest.skip(f"bounds reached; digits not compared: {machine}")
    assert other_digits(KEPT[pattern].short, digits_of(outcomes)) == [], renewal(pattern)


@pytest.mark.evidence
@pytest.mark.parametrize("pattern", MODULES)
def test_three_runs_reach_every_outcome(pattern: str) -> None:
    assert missed(MODULES[pattern].outcomes((0, 1, 2))) == []


@pytest.mark.parametrize("value", [0.2, float("nan")])
def test_a_value_beyond_the_bound_is_not_reached(value: float) -> None:
    assert not at_most("x", "y", 0.1, [0.0, value], "z").is_reached
    assert not at_least("x", "y", 0.1, [-value], "z").is_reached
    assert not at_most("x", "y", 0.1, [], "z").is_reached


def page_of(folder: Path, pattern: str) -> Path:
    """A page with the part that `keep` writes, below another part."""
    page = folder / pattern / "page.md"
    page.parent.mkdir()
    other = "<!-- results: voting -->\n\nvotes\n\n<!-- end of results -->\n"
    page.write_text(
        f"{other}before\n<!-- results: outcomes -->\nold\n<!-- end of results -->\nafter\n"
    )
    return page


def test_kept_outcomes_are_in_a_file_and_in_their_part_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outcome, "PATTERNS", tmp_path)
    page = page_of(tmp_path, "levy_walk")
    one = [at_most("levy_walk", "gap", 1.0, [0.5, 0.75], "ours")]
    still = [at_most("levy_walk", "gap", 1.0, [2.0], "ours")]
    outcome.keep("levy_walk", 20, one, one, still, cpu_minutes=1.5)
    before, _, part = page.read_text().partition("before\n<!-- results: outcomes -->\n")
    table, _, after = part.partition("<!-- end of results -->\n")
    assert (before.splitlines()[2], after) == ("votes", "after\n")
    kept = outcome.kept_outcomes()["levy_walk"]
    assert table.strip() == kept.table
    row = "| gap | <= 1 | 0.5 / 0.625 / 0.75 | 2 (fewer than twenty) | yes | miss it: 2 | ours |"
    assert row in table.splitlines()
    assert kept.made_with["cpu_minutes"] == "1.50"
    levy_walk = next(job for job in JOBS if job.name == "levy_walk")
    assert kept.made_with["digest"] == levy_walk.digest


def test_values_that_are_not_finite_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Robots that never move have no way, and never arrive."""
    monkeypatch.setattr(outcome, "PATTERNS", tmp_path)
    page_of(tmp_path, "drive")
    one = [at_most("drive", "gap", 1.0, [float("inf"), 0.5], "ours")]
    still = [at_most("drive", "gap", 1.0, [float("nan"), 0.5], "ours")]
    outcome.keep("drive", 2, one, one, still)
    kept = outcome.kept_outcomes()["drive"]
    assert kept.outcomes[0].values == (float("inf"), 0.5)
    assert "| **no** | miss it: none | ours |" in kept.table


def test_a_page_without_the_part_is_an_error_and_no_file_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outcome, "PATTERNS", tmp_path)
    page_of(tmp_path, "drive").write_text("no part\n")
    one = [at_most("drive", "gap", 1.0, [0.5], "ours")]
    with pytest.raises(ValueError, match="results: outcomes"):
        outcome.keep("drive", 2, one, one)
    assert outcome.kept_outcomes() == {}


def test_a_statistic_of_all_runs_names_them_and_a_number_without_a_condition_is_not_judged() -> (
    None
):
    bias = at_most("x", "bias", 1.0, [0.5], "z", of_runs=40)
    rate = reported("x", "rate", [0.25] * 20, "z")
    assert bias.cells == ("bias", "<= 1", "0.5", "40", "yes", "z")
    assert rate.cells == ("rate", "-", "0.25 / 0.25 / 0.25", "20", "-", "z")
    assert rate.control == "0.25 / 0.25 / 0.25"


def kept_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *values: float) -> None:
    """Runs of two seeds are kept with these values; the pattern gives 0.5 and 0.25."""
    monkeypatch.setattr(outcome, "PATTERNS", tmp_path)
    page_of(tmp_path, "drive")
    bound = 0.5
    kept = [at_most("drive", "gap", bound, values, "ours")]
    outcome.keep("drive", 2, kept, kept)
    monkeypatch.setitem(
        MODULES,
        "drive",
        SimpleNamespace(
            outcomes=lambda seeds, jobs=1: [at_most("drive", "gap", bound, (0.5, 0.25), "ours")]
        ),
    )


@pytest.mark.parametrize(("values", "status"), [((0.5, 0.25), 0), ((0.5, 0.2500000000000001), 1)])
def test_a_study_fails_on_digits_other_than_the_kept_ones(
    values: tuple[float, ...], status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept_with(tmp_path, monkeypatch, *values)
    assert main(["drive", "--seeds", "2"]) == status


def test_digits_of_another_machine_are_not_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kept_with(tmp_path, monkeypatch, 0.125, 0.25)
    here = {**outcome.software(), "libc": "another 1.0"}
    monkeypatch.setattr(outcome, "software", lambda: here)
    assert main(["drive", "--seeds", "2"]) == 0
    assert "another 1.0" in capsys.readouterr().err


@pytest.mark.parametrize(("kept_gap", "status"), [(0.5, 1), (0.75, 0)])
def test_a_study_fails_on_a_missed_bound_unless_the_page_has_it_as_missed(
    kept_gap: float, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept_with(tmp_path, monkeypatch, kept_gap)
    missed_again = [at_most("drive", "gap", 0.5, [0.75], "ours")]
    monkeypatch.setattr(MODULES["drive"], "outcomes", lambda seeds, jobs=1: missed_again)
    assert main(["drive", "--seeds", "3"]) == status


def test_keep_writes_the_control_of_the_pattern_with_its_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three runs of the control; a missed bound is kept as missed."""
    kept_with(tmp_path, monkeypatch, 0.5)
    asked = []

    def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
        asked.append(list(seeds))
        return [at_most("drive", "gap", 0.5, [0.75 for _ in seeds], "ours")]

    @contextmanager
    def still_robots(pattern: str) -> Iterator[still.Motion]:
        yield still.Motion(is_asked=True)

    monkeypatch.setattr(still, "still_robots", still_robots)
    monkeypatch.setitem(MODULES, "drive", SimpleNamespace(outcomes=outcomes, SEEDS=4))
    assert main(["drive", "--keep"]) == 0
    assert asked == [[0, 1, 2, 3], [SHORT_SEED], [0, 1, 2]]
    kept = outcome.kept_outcomes()["drive"]
    assert (kept.seeds, len(kept.outcomes[0].values), len(kept.still[0].values)) == (4, 4, 3)
    assert float(kept.made_with["cpu_minutes"]) >= 0.0
