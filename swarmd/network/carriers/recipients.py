"""Who gets a datagram by unicast: those whose own datagrams do not arrive by the group. Pure.

Multicast is seldom broken in one direction alone, so that a peer that is heard by the group is
assumed to hear by it, too. Everybody else that is known gets copies: seeds, peers that are heard
by unicast only, and addresses that a robot mentioned. Messages of patterns go to those alone that
are heard, so that a silent address costs a beacon a second.
"""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct

from swarmd.network.datagram import Address

MAX_ADDRESSES = 256
MENTION_TIME = 30.0  # s for which the word of another robot counts


class _AddressUse(Struct):
    by_group: float = -1e9
    heard: float = -1e9
    mentioned: float = -1e9


class Recipients:
    """The addresses that datagrams for all are copied to; a handed-in clock in s, bounded.

    `lease`: for how long hearing an address counts, in s. `with_group` False: there is no group.
    """

    def __init__(self, lease: float, *, with_group: bool = True) -> None:
        self._lease, self._with_group = 2 * lease, with_group
        self._known: dict[Address, _AddressUse] = {}
        self._seeds: frozenset[Address] = frozenset()

    def set_seeds(self, addresses: Iterable[Address]) -> None:
        """The addresses that count whether or not they were ever heard."""
        self._seeds = frozenset(addresses)
        for address in self._seeds:
            self._known.setdefault(address, _AddressUse())

    def on_heard(self, address: Address, by_group: bool, now: float) -> None:
        """A valid datagram came from this address."""
        known = self._place(address, now)
        if known is not None:
            known.heard = now
            if by_group:
                known.by_group = now

    def on_mentioned(self, address: Address, now: float) -> None:
        """A robot says that a living member is at this address."""
        known = self._place(address, now)
        if known is not None:
            known.mentioned = now

    def unicast(self, now: float, *, is_message: bool = False) -> list[Address]:
        """The addresses that get a copy of a datagram, or of a pattern's message, sent now."""
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
