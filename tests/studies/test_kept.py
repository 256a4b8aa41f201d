"""What the commands of studies share: runs that are kept, parts of pages, means with intervals."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from studies import kept


@dataclass
class Run:
    at: float
    opinion: int | None


def test_records_are_made_once_and_read_as_they_were(tmp_path: Path) -> None:
    made = []

    def make() -> list[Run]:
        made.append(1)
        return [Run(1.5, 2), Run(float("inf"), None)]

    for _ in range(2):
        assert kept.once(tmp_path / "a" / "runs", Run, make) == [
            Run(1.5, 2),
            Run(float("inf"), None),
        ]
    assert len(made) == 1


def test_records_that_could_not_be_made_are_made_by_the_next_call(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        kept.once(tmp_path / "runs", Run, lambda: [Run(1.0 / 0.0, 1)])
    assert kept.once(tmp_path / "runs", Run, lambda: [Run(0.0, 1)]) == [Run(0.0, 1)]


def test_records_that_cannot_be_written_to_disk_are_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(handle: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="Input"):
        kept.once(tmp_path / "runs", Run, lambda: [Run(0.0, 1)])
    assert not [*tmp_path.iterdir()]


def test_each_part_has_a_line_with_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    kept.print_parts({"one": "| a |\n", "two": "text"})
    lines = [line for line in capsys.readouterr().out.splitlines() if line]
    assert lines == ["<!-- results: one -->", "| a |", "<!-- results: two -->", "text"]


def test_runs_of_other_sources_are_kept_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    one = kept.kept_folder("paper")
    assert one == kept.kept_folder("paper")
    assert one.parent == Path("build/paper")
    assert kept.kept_folder("learning").name != one.name
    monkeypatch.setattr(kept, "digest_of", lambda modules: f"other of {modules}")
    assert kept.kept_folder("paper") != one


def test_a_mean_leaves_out_unknown_values() -> None:
    assert kept.mean_of(np.array([np.nan])) == "-"
    assert kept.mean_of(np.array([np.nan, 2.0])) == "2.00"
    text = kept.mean_of(np.array([1.0, 2.0, 3.0, np.nan]))
    assert text.startswith("2.00 (")
