"""The size limits of the files of a recording, which `daemon/recording/writer.py` applies.

This module imports no numpy, since the schema of files has these keys.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct


class FileLimits(Struct, frozen=True, kw_only=True):
    """The size limits of a recording.

    - `keep_bytes`: limit for all recordings of this robot; beyond it the oldest are removed.
    - `file_bytes`, `file_seconds`: a new file begins after this size or time.
    """

    keep_bytes: Annotated[int, Meta(ge=2**20)] = 2**30
    file_bytes: Annotated[int, Meta(ge=2**16)] = 2**26
    file_seconds: Annotated[float, Meta(ge=1.0, le=86400.0)] = 600.0
