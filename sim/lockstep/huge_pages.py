"""Huge pages of Linux for the memory of a run.

A run of a hundred robots reads 60 MB of small objects over and over. In pages of 4 kB a processor's
table of addresses (TLB) does not hold them; in pages of 2 MB it does.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from pathlib import Path

_MAPS = Path("/proc/self/maps")
_COLLAPSE = 25  # MADV_COLLAPSE of Linux 6.1; earlier versions refuse it
_SIZE = 2 << 20


def use_huge_pages() -> None:
    """Ask Linux to put the memory that this process has now into huge pages.

    Memory that Linux leaves in small pages stays as it is. No effect on other systems.
    """
    if _MAPS.exists():
        madvise = ctypes.CDLL(None).madvise
        madvise.argtypes = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
        for begin, size in spans(_MAPS.read_text()):
            madvise(begin, size, _COLLAPSE)


def spans(maps: str) -> Iterator[tuple[int, int]]:
    """Address and bytes of the memory of no file, from the begin of a huge page on, if it has one.

    `maps`: the text of /proc/self/maps.
    """
    for line in maps.splitlines():
        span, access, _, _, inode, *name = line.split()
        begin, end = (int(address, 16) for address in span.split("-"))
        begin += -begin % _SIZE
        is_own = access == "rw-p" and inode == "0" and name in ([], ["[heap]"])
        if is_own and end - begin >= _SIZE:
            yield begin, end - begin
