"""The mutants of `python -m benchmarks.mutants`, which takes minutes: that they still apply."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.mutants import COPIED, MUTANTS, ROOT, chosen, row
from benchmarks.mutations import Mutant
from swarmd.errors import SwarmError


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.mechanism)
def test_each_takes_out_something_that_is_there(mutant: Mutant, tmp_path: Path) -> None:
    file = tmp_path / mutant.path
    file.parent.mkdir(parents=True)
    file.write_text((ROOT / mutant.path).read_text())
    mutant.apply(tmp_path)
    compile(file.read_text(), mutant.path, "exec")
    assert file.read_text() != (ROOT / mutant.path).read_text()


@pytest.mark.parametrize("tests", sorted({mutant.tests for mutant in MUTANTS}))
def test_what_is_to_notice_it_is_there_and_copied(tests: str) -> None:
    path, _, name = tests.partition("::")
    assert any(Path(path).is_relative_to(copied) for copied in COPIED)
    assert (ROOT / path).exists()
    assert not name or f"def {name}(" in (ROOT / path).read_text()


@pytest.mark.parametrize(("text", "times"), [("b = 1\n", 0), ("a = 1\na = 1\n", 2)])
def test_one_that_does_not_apply_is_refused(text: str, times: int, tmp_path: Path) -> None:
    (tmp_path / "x.py").write_text(text)
    mutant = Mutant("braking", "no braking", "x.py", "a = 1", "a = 0")
    with pytest.raises(SwarmError, match=f"'braking': x.py holds its text {times} times"):
        mutant.apply(tmp_path)
    assert (tmp_path / "x.py").read_text() == text


def test_one_that_survives_is_told_from_one_that_is_killed() -> None:
    mutant = Mutant("braking", "no braking", "x.py", "a = 1", "a = 0")
    assert row(mutant, []).endswith("| 0 | **none** |")
    assert row(mutant, ["test_a", "test_b"]).endswith("| 2 | `test_a` |")


def test_some_are_chosen_by_a_word_of_their_mechanism() -> None:
    some = chosen(["touch"])
    assert some
    assert all("touch" in mutant.mechanism for mutant in some)
    assert all(m.tests == "tests/outcomes/test_dispersion.py" for m in chosen(["test_dispersion"]))
    assert chosen([]) == list(MUTANTS)
