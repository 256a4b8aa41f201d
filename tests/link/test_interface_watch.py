"""What the kernel says of an interface, as events."""

from __future__ import annotations

import asyncio
import ctypes
import os
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from swarmd.core.errors import NetworkError
from swarmd.link.carriers.interface_watch import (
    InterfaceChange,
    InterfaceEvent,
    InterfaceHistory,
    InterfaceState,
    InterfaceWatch,
    addresses_of,
    index_of,
    read_state,
)
from tests.link.conftest import Until
from tests.support.forked import CLONE_NEWNET

ABSENT = InterfaceState()
DOWN = InterfaceState(True, False, ("10.0.0.5",), 7)
BARE = InterfaceState(True, True, (), 7)
V6 = InterfaceState(True, True, ("fe80::1",), 7)
UP = InterfaceState(True, True, ("10.0.0.5", "fe80::1"), 7)
MOVED = InterfaceState(True, True, ("10.0.0.9", "fe80::1"), 7)


# History


def changes(*states: InterfaceState) -> list[InterfaceChange | None]:
    history = InterfaceHistory("wlan0", states[0])
    return [history.on_state(state) for state in states[1:]]


def told(*states: InterfaceState) -> list[tuple[str, bool, bool] | None]:
    return [(c.line, c.must_reopen, c.must_rejoin) if c else None for c in changes(*states)]


def test_an_address_that_comes_late() -> None:
    assert told(BARE, UP) == [("wlan0: up, 10.0.0.5", False, True)]
    assert told(V6, UP) == [("wlan0: up, 10.0.0.5", False, False)]
    assert told(DOWN, BARE) == [("wlan0: no address yet", False, False)]
    assert told(DOWN, V6) == [("wlan0: no IPv4 address yet, fe80::1", False, True)]


@pytest.mark.parametrize("between", [(), (BARE,), (V6,), (DOWN,), (V6, DOWN, BARE)])
def test_a_changed_address_is_told_whatever_lies_between(
    between: tuple[InterfaceState, ...],
) -> None:
    last = changes(UP, *between, MOVED)[-1]
    assert last is not None
    assert (last.event, last.must_reopen) == (InterfaceEvent.ADDRESS_CHANGED, True)
    assert last.line == "wlan0: address changed: 10.0.0.5 -> 10.0.0.9"


def test_the_same_address_after_a_cut_changes_nothing_but_the_groups() -> None:
    v4_first = InterfaceState(True, True, ("10.0.0.5",), 7)
    assert told(UP, DOWN, v4_first, UP) == [
        ("wlan0: down", False, False),
        ("wlan0: up, 10.0.0.5", False, True),
        ("wlan0: up, 10.0.0.5", False, False),
    ]


def test_an_interface_that_comes_back_has_another_number() -> None:
    again = InterfaceState(True, True, UP.addresses, 8)
    assert told(UP, ABSENT, again) == [
        ("wlan0: absent", False, False),
        ("wlan0: up, 10.0.0.5", True, True),
    ]
    assert told(UP, again) == [("wlan0: up, 10.0.0.5", True, False)]


def test_an_address_beside_those_there_are_breaks_nothing_and_one_of_two_that_goes_does() -> None:
    both = InterfaceState(True, True, ("10.0.0.5", "10.0.0.9", "fe80::1"), 7)
    assert told(UP, both, MOVED) == [
        ("wlan0: up, 10.0.0.5, 10.0.0.9", False, False),
        ("wlan0: address changed: 10.0.0.5 -> 10.0.0.9", True, False),
    ]


def test_a_link_local_address_counts_without_ipv4() -> None:
    other = InterfaceState(True, True, ("fe80::2",), 7)
    assert told(V6, other) == [("wlan0: address changed: fe80::1 -> fe80::2", True, False)]
    assert told(UP, InterfaceState(True, True, ("10.0.0.5",), 7)) == [
        ("wlan0: up, 10.0.0.5", False, False)
    ]


def test_global_ipv6_addresses_come_and_go_without_a_word() -> None:
    more = InterfaceState(True, True, (*UP.addresses, "2001:db8::5"), 7)
    assert told(UP, more, UP) == [None, None]


# The kernel itself


def test_loopback_is_up_and_a_missing_interface_is_absent() -> None:
    state = read_state("lo")
    assert (state.exists, state.is_up, state.index) == (True, True, index_of("lo"))
    assert "127.0.0.1" in addresses_of(index_of("lo"))
    assert read_state("wlan7") == ABSENT
    with pytest.raises(NetworkError, match="'wlan7'"):
        index_of("wlan7")


@pytest.fixture
def elsewhere() -> Iterator[ThreadPoolExecutor]:
    """A thread in a network namespace of its own, which goes with it."""
    if os.geteuid() != 0:
        pytest.skip("a network namespace needs root")
    with ThreadPoolExecutor(1) as pool:
        if pool.submit(ctypes.CDLL(None).unshare, CLONE_NEWNET).result() != 0:
            pytest.skip("network namespaces are not permitted here")
        yield pool


@pytest.mark.integration
def test_addresses_are_listed_by_family_with_labels_and_without_those_that_are_tentative(
    elsewhere: ThreadPoolExecutor,
) -> None:
    def listed() -> tuple[InterfaceState, InterfaceState]:
        for words in (
            "link add v0 type veth peer v1",
            "link set v0 addrgenmode none",
            "link set v0 up",  # without a carrier: IPv6 addresses stay tentative
            "address add fe80::5/64 dev v0",
            "address add fe80::6/64 dev v0 nodad",
            "address add 10.9.0.5/24 dev v0",
            "address add 10.9.0.7/24 dev v0 label v0:b",
            "address add 10.9.0.9/24 dev v1",
        ):
            ip(words)
        return read_state("v0"), read_state("v1")

    v0, v1 = elsewhere.submit(listed).result()
    assert (v0.is_up, v0.addresses) == (False, ("10.9.0.5", "10.9.0.7", "fe80::6"))
    assert v1.addresses == ("10.9.0.9",)


@pytest.mark.integration
def test_the_watch_tells_what_happens_to_an_interface(
    elsewhere: ThreadPoolExecutor, until: Until
) -> None:
    elsewhere.submit(asyncio.run, watch_and_change(until)).result()


def ip(words: str) -> None:
    subprocess.run(["ip", *words.split()], check=True)


async def watch_and_change(until: Until) -> None:
    found: list[InterfaceChange] = []
    watch = InterfaceWatch(asyncio.get_running_loop(), "v0", found.append)
    assert watch.state == ABSENT

    async def after(words: str, is_so: Callable[[InterfaceChange], bool]) -> InterfaceChange:
        for one in words.split("; "):
            ip(one)
        await until(lambda: any(map(is_so, found)))
        told = next(filter(is_so, found))
        found.clear()
        return told

    await after("link add v0 type veth peer v1", lambda c: c.event is InterfaceEvent.DOWN)
    await after(
        "link set v1 up; link set v0 addrgenmode none; link set v0 up",
        lambda c: c.line == "v0: no address yet",
    )
    change = await after("address add 10.9.0.5/24 dev v0", lambda c: c.line == "v0: up, 10.9.0.5")
    assert change.must_rejoin
    change = await after(
        "address del 10.9.0.5/24 dev v0; address add 10.9.0.9/24 dev v0",
        lambda c: c.event is InterfaceEvent.ADDRESS_CHANGED,
    )
    assert change.must_reopen
    await after("link set v1 down", lambda c: c.event is InterfaceEvent.DOWN)  # no carrier
    change = await after("link set v1 up", lambda c: c.event is InterfaceEvent.UP)
    assert (change.must_reopen, change.must_rejoin) == (False, True)
    await after("link del v0", lambda c: c.event is InterfaceEvent.ABSENT)
    change = await after(
        "link add v0 type veth peer v1; link set v1 up; link set v0 addrgenmode none;"
        " link set v0 up; address add 10.9.0.9/24 dev v0",
        lambda c: c.event is InterfaceEvent.UP,
    )
    assert change.must_reopen
    assert watch.state.ipv4 == ("10.9.0.9",)
    watch.close()
    watch.close()
    ip("link set v0 down")
