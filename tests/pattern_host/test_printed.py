"""What patterns print, as lines of the log."""

from __future__ import annotations

from swarmd.pattern_host.runner import MAX_LINE, PRINT_BURST, PRINT_RATE, PrintedLines


def test_lines_are_whole_whatever_the_reads() -> None:
    lines = PrintedLines()
    found = [lines.take(data, 1.0) for data in (b"one\ntw", b"o", b"\n\nthree\n")]
    assert found == [["one"], [], ["two", "three"]]


def test_a_flood_is_cut_and_counted() -> None:
    lines = PrintedLines()
    assert len(lines.take(b"x\n" * 5000, 1.0)) == PRINT_BURST
    assert lines.take(b"y\n", 1.0) == []
    later = lines.take(b"z\n", 1.0 + 1.0 / PRINT_RATE)
    assert later == [f"[{5001 - int(PRINT_BURST)} lines left out]", "z"]


def test_a_line_without_end_is_bounded() -> None:
    lines = PrintedLines()
    for _ in range(100):
        assert lines.take(b"x" * 65536, 1.0) == []
    (line,) = lines.take(b"\n", 1.0)
    assert len(line) == MAX_LINE
    assert lines.take(b"\xff\n", 1.0) == ["\ufffd"]
