"""Durations of the command line."""

from __future__ import annotations

import click
import pytest

from swarmd.operator.cli.options import Duration


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("60", 60.0), ("60s", 60.0), ("1.5m", 90.0), ("500ms", 0.5), ("2h", 7200.0), (" 3S ", 3.0)],
)
def test_reads_durations(text: str, seconds: float) -> None:
    assert Duration().convert(text, None, None) == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["", "0", "0s", "-3s", "s", "3 days", "nan", "1e9h", "1e3s"])
def test_refuses_wrong_durations(text: str) -> None:
    with pytest.raises(click.BadParameter, match="is no duration"):
        Duration().convert(text, None, None)
