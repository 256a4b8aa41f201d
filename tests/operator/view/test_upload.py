"""The file that a page sends in pieces: whole, or not at all."""

from __future__ import annotations

import base64
from typing import Any

import pytest

from swarmd.core.pattern_manifest import MAX_CODE
from swarmd.operator.view.upload import Upload


def piece(offset: Any, data: bytes, id: str = "a") -> dict[str, Any]:
    return {"id": id, "offset": offset, "data": base64.b64encode(data).decode()}


def test_pieces_make_a_file_for_their_command_alone() -> None:
    upload = Upload()
    upload.take(piece(0, b"one "))
    upload.take(piece(4, b"two"))
    assert upload.end("b") == b""
    upload.take(piece(0, b"one "))
    upload.take(piece(0, b"other", "b"))
    assert upload.end("b") == b"other"
    assert upload.end("b") == b""


@pytest.mark.parametrize(
    "wrong",
    [
        piece(9, b"late"),
        piece(0, b"again"),
        piece(None, b""),
        piece("4", b"x"),
        {"id": "a", "offset": 4, "data": "no base 64!"},
        {"id": "a", "offset": 4, "data": 7},
        {"id": "a", "offset": 4, "data": "é"},
        {"id": "a", "offset": 4},
    ],
)
def test_a_piece_that_does_not_follow_is_dropped(wrong: dict[str, Any]) -> None:
    upload = Upload()
    upload.take(piece(0, b"one "))
    upload.take(wrong)
    assert upload.end("a") == b"one "


def test_no_file_is_larger_than_a_pattern() -> None:
    upload = Upload()
    half = bytes(MAX_CODE // 2)
    for n in range(4):
        upload.take(piece(n * len(half), half))
    assert len(upload.end("a")) == MAX_CODE
