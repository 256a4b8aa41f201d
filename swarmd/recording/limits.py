"""The size limits of the files of a recording, which `writer.py` applies.

This module imports no numpy, since the settings use these limits, too.
"""

from __future__ import annotations

from msgspec import Struct


class FileLimits(Struct, frozen=True, array_like=True):
    """The size limits of a recording: a new file begins after `file_bytes` or `file_seconds`.

    `keep_bytes`: the limit for all files of a robot; beyond this limit the oldest files are
    removed.
    """

    file_bytes: int = 2**26
    file_seconds: float = 600.0
    keep_bytes: int = 2**30
