"""Mutants: which ones are made and drawn, and what the list of survivors must say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from studies.mutants.judged import Judged, faults, read
from studies.mutants.mutant import Mutant, is_drawn, mutants_of
from studies.mutants.subjects import ROOT, subjects
from swarmd.core.errors import ConfigError

SOURCE = '''
from __future__ import annotations

Kind = int | str


def clip(value: int | None = 3, *more: int) -> float | None:
    """Between 0 and 9."""
    if value is None:
        return None
    return value if value < 9 else 8 + 1
'''


def made(source: str) -> Sequence[Mutant]:
    pytest.importorskip("cosmic_ray")
    return [mutant for mutant, _ in mutants_of("a.py", source)]


def test_operators_numbers_and_conditions_change_and_types_do_not() -> None:
    """The wanted values are by hand: neighbours of each comparison and number, and the sum."""
    returns = [one for one in made(SOURCE) if one.was.startswith("return")]
    found = {(one.was.removeprefix("return "), one.now.removeprefix("return ")) for one in returns}
    line = "value if value < 9 else 8 + 1"
    assert found == {
        (line, "value if value <= 9 else 8 + 1"),
        (line, "value if value >= 9 else 8 + 1"),
        (line, "value if not value < 9 else 8 + 1"),
        (line, "value if value < 10 else 8 + 1"),
        (line, "value if value < 8 else 8 + 1"),
        (line, "value if value < 9 else 8 - 1"),
        (line, "value if value < 9 else 9 + 1"),
        (line, "value if value < 9 else 7 + 1"),
        (line, "value if value < 9 else 8 + 2"),
        (line, "value if value < 9 else 8 + 0"),
    }
    others = {one.was for one in made(SOURCE) if not one.was.startswith("return")}
    assert others == {
        "if value is None:",
        "def clip(value: int | None = 3, *more: int) -> float | None:",
    }
    assert all("int & " not in one.now and "/more" not in one.now for one in made(SOURCE))


def test_a_draw_repeats_and_a_change_of_other_lines_changes_none() -> None:
    places = [f"a.py f NumberReplacer x = {n} 1" for n in range(3000)]
    drawn = [place for place in places if is_drawn(place, 50)]
    assert drawn == [place for place in reversed(places) if is_drawn(place, 50)][::-1]
    assert 30 < len(drawn) < 90
    assert all(is_drawn(place, 1) for place in places)


MUTANT = Mutant(path="a.py", inside="f", was="x < 1", now="x <= 1")


def judged(kind: str) -> dict[Mutant, Judged]:
    return {MUTANT: Judged(path="a.py", inside="f", was="x < 1", now="x <= 1", kind=kind, why="-")}


@pytest.mark.parametrize(
    ("is_killed", "kind", "is_fault"),
    [
        (False, "", True),
        (False, "killed", True),
        (False, "open", False),
        (False, "equivalent", False),
        (True, "", False),
        (True, "killed", False),
        (True, "open", True),
        (True, "equivalent", True),
    ],
)
def test_a_survivor_that_is_not_listed_fails(is_killed: bool, kind: str, is_fault: bool) -> None:
    found = faults({MUTANT: is_killed}, judged(kind) if kind else {})
    assert [MUTANT.name in text for text in found] == [True] * is_fault


def test_a_row_without_its_mutant_fails_once_all_were_tried() -> None:
    assert len(faults({}, judged("open"))) == 1
    assert faults({}, judged("open"), is_whole=False) == []


def test_the_list_names_files_of_the_subjects_with_a_reason() -> None:
    paths = {path for subject in subjects() for path in subject.paths}
    assert {row.path for row in read().values()} <= paths
    for subject in subjects():
        for name in (*subject.paths, *subject.tests, *subject.more):
            assert (ROOT / name).exists(), name


def test_a_row_without_a_reason_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "survivors.toml"
    row = '[[survivors]]\npath = "a.py"\ninside = "f"\nwas = "x"\nnow = "y"\n'
    for kind, why in (("open", " "), ("fine", "so")):
        file.write_text(f'{row}kind = "{kind}"\nwhy = "{why}"\n')
        with pytest.raises(ConfigError, match="x -> y"):
            read(file)
