"""Huge pages: what memory Linux is asked for, when, and that the memory stays as it is."""

from __future__ import annotations

import ctypes
from pathlib import Path
from types import SimpleNamespace

import pytest

from swarmd.sim.lockstep import huge_pages
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenariofile import load_scenario

# As of proc(5). A path is of any bytes but a newline.
MAPS = b"""\
00400000-00e00000 r-xp 00000000 fd:00 1234                               /usr/bin/python3.11
00e00000-02000000 rw-p 00a00000 fd:00 1234                               /caf\xe9/two words\x0b\x85
10100000-10a00000 rw-p 00000000 00:00 0                                  [heap]
20000000-20200000 rw-p 00000000 00:00 0
30000000-30100000 rw-p 00000000 00:00 0
30180000-30400000 rw-p 00000000 00:00 0
40000000-41000000 rw-s 00000000 00:01 77                                 /dev/shm/one of three words
50000000-51000000 r--p 00000000 00:00 0                                  [vvar]
60000000-61000000 ---p 00000000 00:00 0
61000000-62000000 rw-p 00000000 00:00 0                                  [anon:of another]
7ffd00000000-7ffd01000000 rw-p 00000000 00:00 0                          [stack]
"""


def test_memory_keeps_its_contents() -> None:
    held = bytearray(range(256)) * (1 << 15)  # 8 MB
    huge_pages.use_huge_pages()
    assert held == bytearray(range(256)) * (1 << 15)


OWN = [(0x10200000, 0x00800000), (0x20000000, 0x00200000), (0x30200000, 0x00200000)]


@pytest.mark.parametrize("has_function", [True, False])
@pytest.mark.parametrize(
    ("maps", "asked"),
    [(MAPS, OWN), (MAPS + b"no map\n", OWN), (b"no map\n" + MAPS, []), (OSError("refused"), [])],
    ids=["usual", "odd at the end", "odd at the start", "refused"],
)
def test_what_cannot_be_asked_for_is_left(
    maps: bytes | OSError, asked: object, monkeypatch: pytest.MonkeyPatch, *, has_function: bool
) -> None:
    def read(path: Path) -> bytes:
        if isinstance(maps, OSError):
            raise maps
        return maps

    calls: list[tuple[int, int]] = []

    def madvise(begin: int, size: int, advice: int) -> int:
        assert advice == 25  # MADV_COLLAPSE of linux/mman.h
        calls.append((begin, size))
        return -1

    library = SimpleNamespace(madvise=madvise) if has_function else SimpleNamespace()
    monkeypatch.setattr(Path, "read_bytes", read)
    monkeypatch.setattr(ctypes, "CDLL", lambda name: library)
    huge_pages.use_huge_pages()
    assert calls == (asked if has_function else [])


@pytest.mark.parametrize(("robots", "asked_at"), [(63, []), (64, [pytest.approx(0.1)])])
def test_a_large_run_asks_once(
    robots: int, asked_at: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    changes = {"arena.size": [20.0, 20.0], "groups.all.count": robots}
    monkeypatch.setattr("swarmd.sim.lockstep.lockstep._HUGE_PAGES_AT", 0.1)
    run = Lockstep(load_scenario("thousand", {**changes, "groups.all.pattern": "drive"}), seed=0)
    asked: list[float] = []
    monkeypatch.setattr(
        "swarmd.sim.lockstep.lockstep.use_huge_pages", lambda: asked.append(run.world.time)
    )
    run.advance(0.3)
    assert asked == asked_at
