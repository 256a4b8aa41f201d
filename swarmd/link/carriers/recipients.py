"""The addresses that get a unicast copy of a datagram for all. Pure.

A peer that is heard by the multicast group is assumed to hear the group, and gets no copy:
multicast is seldom broken in one direction only. All other known addresses get copies: seeds, peers
that are heard by unicast only, and addresses in the member lists of robots. Messages of patterns go
only to addresses that are heard, so that a silent address costs no more than a beacon per second.
"""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct

from swarmd.link.datagram import Address

MAX_ADDRESSES = 256
MENTION_TIME = 30.0  # s for which an address that a robot mentioned gets copies


class _AddressUse(Struct):
    """The times in s of the last datagram by multicast, by any way, and of the last mention."""

    by_group: float = -1e9
    heard: float = -1e9
    mentioned: float = -1e9


class Recipients:
    """The known addresses: the seeds, and at most MAX_ADDRESSES others.

    `lease`: s. An address counts as heard for two leases after each datagram. `with_group` False:
    multicast is off, and every known address gets copies.
    """

    def __init__(self, lease: float, *, with_group: bool = True) -> None:
        self._lease = 2 * lease
        self._with_group = with_group
        self._known: dict[Address, _AddressUse] = {}
        self._seeds: frozenset[Address] = frozenset()

    def set_seeds(self, addresses: Iterable[Address]) -> None:
        """Set the seeds: addresses that get copies whether or not they were ever heard."""
        self._seeds = frozenset(addresses)
        for address in self._seeds:
            self._known.setdefault(address, _AddressUse())

    def on_heard(self, address: Address, by_group: bool, now: float) -> None:
        """Note a valid datagram from this address; `by_group`: it came by multicast."""
        known = self._place(address, now)
        if known is not None:
            known.heard = now
            if by_group:
                known.by_group = now

    def on_mentioned(self, address: Address, now: float) -> None:
        """Note that a robot reports a living member at this address."""
        known = self._place(address, now)
        if known is not None:
            known.mentioned = now

    def unicast(self, now: float, *, is_message: bool = False) -> list[Address]:
        """The addresses that get a copy of a datagram sent now.

        `is_message`: the datagram is a pattern's message, which goes only to addresses heard.
        """
        chosen = []
        for address, known in list(self._known.items()):
            if not self._is_current(address, known, now):
                del self._known[address]
                continue
            hears_group = self._with_group and now - known.by_group <= self._lease
            if not hears_group and (not is_message or now - known.heard <= self._lease):
                chosen.append(address)
        return chosen

    def _place(self, address: Address, now: float) -> _AddressUse | None:
        known = self._known.get(address)
        if known is None:
            if len(self._known) >= MAX_ADDRESSES:
                self._known = {
                    known_address: use
                    for known_address, use in self._known.items()
                    if self._is_current(known_address, use, now)
                }
            if len(self._known) < MAX_ADDRESSES:
                known = self._known[address] = _AddressUse()
        return known

    def _is_current(self, address: Address, known: _AddressUse, now: float) -> bool:
        return (
            address in self._seeds
            or now - known.heard <= self._lease
            or now - known.mentioned <= MENTION_TIME
        )
