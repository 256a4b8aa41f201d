"""Huge pages of Linux for the memory of a run.

A run of a hundred robots reads 60 MB of small objects over and over. In pages of 4 kB a processor's
table of addresses (TLB) does not hold them; in pages of 2 MB it does.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_COLLAPSE = 25  # MADV_COLLAPSE of Linux 6.1; earlier versions refuse it
_SIZE = 2 << 20


def use_huge_pages() -> None:
    """Ask Linux to put the memory that this process has now into huge pages.

    It takes some 1 ms for each MB. Linux also copies what a fork shares with its parent.
    What Linux leaves in small pages stays as it is. No effect on other systems.
    """
    with suppress(OSError, AttributeError, ValueError):  # no such file or function, an odd line
        maps = Path("/proc/self/maps").read_bytes()
        madvise = ctypes.CDLL(None).madvise
        madvise.argtypes = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
        for begin, size in spans(maps):
            madvise(begin, size, _COLLAPSE)


def spans(maps: bytes) -> Iterator[tuple[int, int]]:
    """Address and length in bytes of private memory that may be written, and that is of no file.

    Stacks and named memory are left out. Each span starts with a huge page, and holds one at least.
    `maps`: the contents of /proc/self/maps.
    """
    for line in maps.split(b"\n")[:-1]:
        span, access, _, _, inode, *name = line.split()
        begin, end = (int(address, 16) for address in span.split(b"-"))
        begin += -begin % _SIZE
        is_own = access == b"rw-p" and inode == b"0" and name in ([], [b"[heap]"])
        if is_own and end - begin >= _SIZE:
            yield begin, end - begin
