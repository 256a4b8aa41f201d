"""Keys from the bytes of a terminal."""

from __future__ import annotations

import pytest

from swarmd.view.screen import PASTED, KeyDecoder


@pytest.mark.parametrize(
    ("data", "keys"),
    [
        (b"ae \r\t\x7f\x05", ["a", "e", "space", "enter", "tab", "backspace", "ctrl-e"]),
        (b"\x1b[A\x1b[B\x1bOC\x1b[5~\x1b[6~\x1b[H\x1b[4~",
         ["up", "down", "right", "pageup", "pagedown", "home", "end"]),
        (b"\x1b[1;5A", ["up"]),
        (b"\x1b[1;5e\x1b[<0;3;4mx\x1b[?1;2cx", ["x", "x"]),
        (b"\x1bx", ["escape", "x"]),
        (b"\x1b\x1b[A", ["escape", "up"]),
        ("é\x01".encode(), ["é"]),
        (b"\x1b[200~run e\n\x1b[A\x1b[201~q", [f"{PASTED}run e\n\x1b[A", "q"]),
        (b"\xff\xfe", []),
    ],
)  # fmt: skip
def test_bytes_become_keys_whole_or_one_by_one(data: bytes, keys: list[str]) -> None:
    whole, single = KeyDecoder(), KeyDecoder()
    assert whole.feed(data) == keys
    assert [key for byte in data for key in single.feed(bytes((byte,)))] == keys


def test_escape_alone_is_a_key_once_nothing_follows() -> None:
    decoder = KeyDecoder()
    assert decoder.feed(b"\x1b") == []
    assert decoder.is_pending
    assert decoder.flush() == ["escape"]
    assert decoder.feed(b"\x1b[") == []
    assert decoder.flush() == []
    assert decoder.feed(b"q") == ["q"]
