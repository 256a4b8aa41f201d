"""Typed bytes from the bytes of a terminal."""

from __future__ import annotations

import pytest

from swarmd.operator.view.screen import SEQUENCE_TIME, TypedKeys


def fed(*parts: bytes) -> bytes:
    """What is typed, without the marks of left out sequences."""
    keys = TypedKeys()
    return b"".join(keys.feed(part, 0.0) for part in parts).replace(b"\0", b"")


@pytest.mark.parametrize(
    ("data", "typed"),
    [
        (b"se\x05q", b"se\x05q"),
        (b"\x1b[A\x1bOS\x1b[5~\x1b[Hq", b"q"),
        (b"\x1b[1;5e\x1b[<0;3;4mx\x1b[?1;2cx", b"xx"),
        (b"\x1be", b"e"),
        (b"\x1b\x1b[Ae", b"e"),
        (b"\x1b[200~run e\n\x1b[A\x1b[201~q", b"q"),
        (b"\x1b[200~" + 999 * b"seq" + b"\x1b[201~s", b"s"),
    ],
)
def test_sequences_and_pasted_text_are_left_out_whole_or_in_parts(
    data: bytes, typed: bytes
) -> None:
    assert fed(data) == typed
    for size in (1, 2, 5):
        assert fed(*(data[at : at + size] for at in range(0, len(data), size))) == typed


def test_a_sequence_without_its_end_swallows_no_later_key() -> None:
    keys = TypedKeys()
    assert keys.feed(b"\x1b[", 10.0) == b""
    assert keys.feed(b"e", 10.1 + SEQUENCE_TIME) == b"e"
    assert keys.feed(b"\x1b", 20.0) == b""
    assert keys.feed(b"e", 20.1) == b"\0e"
