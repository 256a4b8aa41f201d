"""The limits of the files of a recording; `writer.py` keeps to them.

Imports no numpy: the settings hold them, too.
"""

from __future__ import annotations

from msgspec import Struct


class FileLimits(Struct, frozen=True, array_like=True):
    """When a new file begins: after `file_bytes` or `file_seconds`.

    `keep_bytes`: of all files of a robot; the oldest are removed beyond it.
    """

    file_bytes: int = 2**26
    file_seconds: float = 600.0
    keep_bytes: int = 2**30
