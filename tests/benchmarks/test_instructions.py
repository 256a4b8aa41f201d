"""Costs in instructions: what is read from callgrind, and which ratio holds."""

from __future__ import annotations

import pytest

from benchmarks import instructions

# Of callgrind 3.19, shortened by hand.
DUMPED = """version: 1
creator: callgrind-3.19.0
part: 2
desc: Trigger: Client Request: scan and decision / 20
events: Ir
summary: 18446744073698164101

fl=(1) libpython
totals: 5000
"""
AT_THE_END = DUMPED.replace("Client Request: scan and decision / 20", "Program termination")


def test_a_call_costs_the_sum_of_its_dump_over_its_calls() -> None:
    assert instructions.counted([AT_THE_END, DUMPED]) == {"scan and decision": 250.0}


@pytest.mark.parametrize(
    ("now", "is_over"), [(1019.0, False), (1020.0, False), (1021.0, True), (700.0, False)]
)
def test_two_percent_more_than_the_earlier_commit_hold(now: float, is_over: bool) -> None:
    found = instructions.ratios({"a": now, "new row": 5.0}, {"a": 1000.0, "gone": 3.0})
    assert found == {"a": now / 1000.0, "new row": None}
    assert [text.partition(":")[0] for text in instructions.over(found)] == ["a"] * is_over


def test_without_callgrind_nothing_is_counted_and_the_remedy_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("benchmarks.instructions.shutil.which", lambda name: None)
    monkeypatch.setattr(instructions, "built", lambda revision: pytest.fail("it builds"))
    assert instructions.main(["--against", "HEAD"]) == 0
    assert "apt install valgrind" in capsys.readouterr().err
