"""The file that a page sends in pieces, before the command that uses it."""

from __future__ import annotations

import binascii
from collections.abc import Mapping
from typing import Any

from swarmd.core.pattern_manifest import MAX_CODE


class Upload:
    """One file of one page at a time; a piece of another file begins anew."""

    def __init__(self) -> None:
        self._id = ""
        self._content = bytearray()

    def take(self, message: Mapping[str, Any]) -> None:
        """Take a piece: `id` of the command to come, `offset`, and `data` in base 64.

        A piece that does not follow the last one, is damaged, or makes the file larger than any
        pattern is dropped, so that the file is not whole.
        """
        id = str(message.get("id"))[:64]
        if id != self._id:
            self._id = id
            self._content = bytearray()
        try:
            piece = binascii.a2b_base64(message.get("data", ""), strict_mode=True)
        except (ValueError, TypeError):
            return
        if message.get("offset") == len(self._content) <= MAX_CODE - len(piece):
            self._content += piece

    def end(self, id: str) -> bytes:
        """The bytes that came for the command `id`; they are kept no longer."""
        content = bytes(self._content) if id == self._id else b""
        self._id = ""
        self._content = bytearray()
        return content
