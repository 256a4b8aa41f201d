"""Imports without OpenSSL, which takes 4 MB and some ms: asyncio and hashlib work without it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec


@contextmanager
def without_openssl() -> Iterator[None]:
    """Hide OpenSSL from imports in the block.

    Imports after the block find OpenSSL, such as `import ssl` of a robot with keys. If this Python
    has no built-in hash functions, hashlib needs OpenSSL, and nothing is hidden.
    """
    has_own = any(map(find_spec, ("_sha2", "_sha256")))  # of Python 3.12 and later, of 3.11
    hidden = {"ssl", "_ssl", "_hashlib"} - sys.modules.keys() if has_own else set[str]()
    sys.modules.update(dict.fromkeys(hidden))  # type: ignore[arg-type]  # None: ImportError
    try:
        yield
    finally:
        for name in hidden:
            del sys.modules[name]
