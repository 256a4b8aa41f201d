"""What the commands of studies share: parts of pages, means with intervals."""

from __future__ import annotations

import numpy as np
import pytest

from studies import kept


def test_each_part_has_a_line_with_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    kept.print_parts({"one": "| a |\n", "two": "text"})
    lines = [line for line in capsys.readouterr().out.splitlines() if line]
    assert lines == ["<!-- results: one -->", "| a |", "<!-- results: two -->", "text"]


def test_a_mean_leaves_out_unknown_values() -> None:
    assert kept.mean_of(np.array([np.nan])) == "-"
    assert kept.mean_of(np.array([np.nan, 2.0])) == "2.00"
    text = kept.mean_of(np.array([1.0, 2.0, 3.0, np.nan]))
    assert text.startswith("2.00 (")
