"""Huge pages: what memory Linux is asked for, and that a run keeps its bits."""

from __future__ import annotations

import pytest

from swarmd.sim.lockstep import huge_pages
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenariofile import load_scenario

# As of proc(5).
MAPS = """\
00400000-00e00000 r-xp 00000000 fd:00 1234                               /usr/bin/python3.11
00e00000-02000000 rw-p 00a00000 fd:00 1234                               /usr/bin/python3.11
10100000-10a00000 rw-p 00000000 00:00 0                                  [heap]
20000000-20200000 rw-p 00000000 00:00 0
30000000-30100000 rw-p 00000000 00:00 0
30180000-30400000 rw-p 00000000 00:00 0
40000000-41000000 rw-s 00000000 00:01 77                                 /dev/shm/one of three words
50000000-51000000 r--p 00000000 00:00 0                                  [vvar]
60000000-61000000 ---p 00000000 00:00 0
7ffd00000000-7ffd01000000 rw-p 00000000 00:00 0                          [stack]
"""


def test_only_own_memory_that_holds_a_huge_page_is_asked_for() -> None:
    assert list(huge_pages.spans(MAPS)) == [
        (0x10200000, 0x00800000),
        (0x20000000, 0x00200000),
        (0x30200000, 0x00200000),
    ]


def test_memory_keeps_its_contents() -> None:
    held = bytearray(range(256)) * (1 << 15)  # 8 MB
    huge_pages.use_huge_pages()
    assert held == bytearray(range(256)) * (1 << 15)


@pytest.mark.parametrize(("robots", "asked_at"), [(31, []), (32, [pytest.approx(1.2)])])
def test_a_large_run_asks_once(
    robots: int, asked_at: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    changes = {"arena.size": [6.0, 6.0], "groups.all.count": robots}
    run = Lockstep(load_scenario("thousand", changes), seed=0)
    asked: list[float] = []
    monkeypatch.setattr(
        "swarmd.sim.lockstep.lockstep.use_huge_pages", lambda: asked.append(run.world.time)
    )
    for _ in range(3):
        run.advance(0.6)
    assert asked == asked_at
