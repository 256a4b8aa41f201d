"""What a source may say, and what is left to the kernel."""

from __future__ import annotations

import pytest

from swarmd.link.carriers.flood_limits import (
    BLOCK_TIME,
    BURST,
    EXCESS,
    KNOWN_TIME,
    MAX_BLOCK_TIME,
    MAX_BLOCKED,
    MAX_SOURCES,
    MAX_THINNED,
    MIN_SHARE,
    RATE,
    FloodLimits,
    FloodRules,
)
from swarmd.link.carriers.packet_filter import swarm_filter
from swarmd.link.datagram import Address, Kind
from swarmd.link.members.membership import MAX_MEMBERS

LOUD, QUIET = ("10.0.0.66", 7440), ("10.0.0.5", 7440)


def say(
    limits: FloodLimits, source: Address, count: int, now: float, kind: int = Kind.BEACON
) -> int:
    """How many of these datagrams at one moment are admitted."""
    return sum(limits.admits(source, kind, now) for _ in range(count))


def test_a_source_is_held_to_its_rate_and_others_are_not_touched() -> None:
    limits = FloodLimits()
    passed = 0
    for step in range(100):
        passed += say(limits, LOUD, 8, step / 100)
        assert say(limits, QUIET, 1, step / 100) == 1
    assert abs(passed - (BURST + RATE)) <= 8
    assert limits.dropped == {"flood:beacon": 800 - passed}


def test_no_flood_of_other_kinds_shuts_out_a_stop_of_the_same_source() -> None:
    limits = FloodLimits()
    say(limits, LOUD, 10_000, 0.0)
    say(limits, LOUD, 10_000, 0.0, kind=200)
    for kind in (Kind.STOP, Kind.ACK, Kind.LATCHES):
        assert limits.admits(LOUD, kind, 0.0)
    assert limits.dropped["flood:unknown"] == 10_000


def test_a_flood_is_left_to_the_kernel_for_a_while_and_longer_if_repeated() -> None:
    limits = FloodLimits()
    assert limits.rules(0.0) == FloodRules()
    say(limits, LOUD, int(BURST) + EXCESS, 0.0)
    assert limits.rules(0.0) == FloodRules(blocked=(LOUD,))
    assert limits.rules(BLOCK_TIME - 0.1) is limits.rules(BLOCK_TIME - 0.2)
    now = BLOCK_TIME + 0.1
    assert limits.rules(now) == FloodRules()
    ends = []
    for _ in range(6):
        say(limits, LOUD, int(BURST) + EXCESS, now)
        begin = now
        while limits.rules(now).blocked:
            now += 0.5
        ends.append(now - begin)
        now += 1.5
    assert ends[0] >= 2 * BLOCK_TIME
    assert ends == sorted(ends)
    assert MAX_BLOCK_TIME <= ends[-1] <= MAX_BLOCK_TIME + 1.0


def test_a_flood_of_stops_is_thinned_and_never_blocked() -> None:
    limits = FloodLimits()
    for step in range(10):
        say(limits, LOUD, 1_000, step / 100, Kind.STOP)
    rules = limits.rules(0.1)
    assert rules == FloodRules(thinned=rules.thinned)
    ((source, share),) = rules.thinned
    assert source == LOUD
    assert MIN_SHARE <= share <= 0.1


def test_a_flood_that_goes_on_is_thinned_more() -> None:
    limits = FloodLimits()
    for second in range(3):
        for step in range(10):
            say(limits, LOUD, 1_000, second + step / 10, Kind.STOP)
    ((_, share),) = limits.rules(3.0).thinned
    assert share == MIN_SHARE


@pytest.mark.parametrize("sources", [200, 20_000])
def test_forged_sources_neither_fill_the_memory_nor_shut_out_those_that_were_there(
    sources: int,
) -> None:
    limits = FloodLimits()
    say(limits, QUIET, 1, 0.0)
    now = KNOWN_TIME + 0.1
    assert limits.admits(QUIET, Kind.BEACON, now)
    for _ in range(3):  # it goes on for longer than a source takes to be known
        for number in range(20_000):
            limits.admits(forged(number % sources), Kind.BEACON, now)
        assert limits.rules(now) == FloodRules(only_known=True, known=(QUIET,))
        assert limits.admits(QUIET, Kind.BEACON, now)
        for _ in range(30):
            now += 1.0
            assert limits.admits(QUIET, Kind.BEACON, now)
        assert not limits.rules(now).only_known
    for number in range(20_000):
        limits.admits(forged(number % sources), Kind.STOP, now)
    rules = limits.rules(now)
    assert MIN_SHARE <= rules.share < 0.2
    assert rules.known == (QUIET,)
    assert limits.admits(QUIET, Kind.STOP, now)
    assert len(limits._sources) <= MAX_SOURCES
    assert limits.rules(now + 10 * BLOCK_TIME) == FloodRules()


def test_a_flood_of_which_a_part_is_read_counts_whole() -> None:
    limits = FloodLimits()
    for step in range(40):
        limits.admits(QUIET, Kind.BEACON, step / 10)
    now = 4.0
    for step in range(100):  # 1,000 a second are read of 16,000: less than any budget
        for number in range(10):
            limits.admits(forged(10 * step + number), Kind.BEACON, now, 16.0)
        if step % 16 == 0:  # of 10 a second
            assert limits.admits(QUIET, Kind.BEACON, now, 16.0)
        now += 0.01
    assert limits.rules(now) == FloodRules(only_known=True, known=(QUIET,))


def test_many_robots_that_start_at_once_are_no_flood() -> None:
    limits = FloodLimits()
    for step in range(20):
        for number in range(100):  # each claims its id at 10 Hz, by two ways
            assert say(limits, forged(number), 2, step / 10) == 2
    assert limits.rules(2.0) == FloodRules()


def test_a_thousand_robots_that_tell_kin_are_heard_whole() -> None:
    limits = FloodLimits()
    for second in range(6):  # until each is known, and longer: a beacon, and kin at 5 Hz
        for part in range(6):
            for number in range(1000):
                kind = Kind.KIN if part else Kind.BEACON
                limits.admits(forged(number), kind, second + part / 6 + number / 6000)
    assert limits.dropped == {}
    assert limits.rules(6.0) == FloodRules()
    now = 6.0
    for number in range(20_000):  # a flood beside them shuts out none of them
        limits.admits(forged(2**20 + number), Kind.BEACON, now)
    rules = limits.rules(now)
    assert rules.only_known
    assert set(rules.known) == {forged(number) for number in range(1000)}
    assert all(limits.admits(forged(number), Kind.KIN, now) for number in range(1000))


def test_the_table_has_a_place_for_each_member_and_its_filter_fits_the_kernel() -> None:
    assert MAX_SOURCES >= MAX_MEMBERS
    sources = tuple(forged(number) for number in range(MAX_SOURCES))
    rules = FloodRules(
        blocked=sources[:MAX_BLOCKED],
        thinned=tuple((source, 0.5) for source in sources[:MAX_THINNED]),
        share=0.5,
        only_known=True,
        known=sources,
    )
    program = swarm_filter(bytes(8), rules, is_ipv6=False)
    assert len(program) // 8 <= 4096  # BPF_MAXINSNS of linux/bpf_common.h


def forged(number: int) -> Address:
    return f"10.{number >> 16}.{number >> 8 & 255}.{number & 255}", 9


def test_the_rules_are_bounded() -> None:
    limits = FloodLimits()
    for number in range(100):
        source = (f"10.0.{number}.1", 7440)
        say(limits, source, int(BURST) + EXCESS, 0.0)
        say(limits, source, int(BURST) + EXCESS, 0.0, Kind.STOP)
    rules = limits.rules(0.0)
    assert 0 < len(rules.blocked) <= 64
    assert 0 < len(rules.thinned) <= 8
    assert len(rules.shortened().blocked) < len(rules.blocked)
