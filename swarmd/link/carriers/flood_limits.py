"""Rate limits for each source of datagrams, so that a flood costs only its sender. Pure.

Urgent datagrams are stops, acks and latches (`URGENT`).

1. Each source has two budgets: one of urgent datagrams, one of all others. So a flood of beacons,
   even with the forged address of a robot, uses nothing of the robot's budget of stops.
2. A source that is EXCESS datagrams beyond a budget is blocked for some seconds: the kernel's
   packet filter drops all its datagrams that are not urgent, and passes a random share of its
   urgent datagrams.
3. Each datagram of a new source (stranger) also counts in a budget that all new sources share. A
   flood from forged addresses exceeds this shared budget. Then for some seconds the filter passes
   all datagrams of known sources, and of new sources only a share of the urgent datagrams.
4. After its first datagram a new source may send STRANGER_RATE datagrams a second, not urgent ones,
   that do not count in the shared budget. Otherwise a robot that starts among 1,000 robots would
   take all of them for one flood, and would never get to know them.

A process that gets little CPU time reads only a part of a flood. So each datagram that is read
counts with a weight: the number of arrived datagrams divided by the number of read datagrams.
Callers hand in the time, in s on one monotonic clock.
"""

from __future__ import annotations

from collections import Counter

from msgspec import Struct, field
from msgspec.structs import replace

from swarmd.core.token_bucket import TokenBucket
from swarmd.link.datagram import URGENT, Address, Kind

# Datagrams per second of a source. A robot's patterns may send 100 messages a second, which are
# sent twice while broadcast is the fallback.
RATE = 400.0
BURST = 400.0
URGENT_RATE = 800.0  # a robot that relays a stop also hands on the acks of other robots
STRANGERS_RATE = 2000.0  # datagrams a second of all new sources together
# Datagrams a second of one new source beside `STRANGERS_RATE`: a beacon, five of kin and four
# messages of a chatting pattern. So MAX_SOURCES forged addresses pass at most 10,880 a second.
STRANGER_RATE = 10.0
EXCESS = 400  # datagrams beyond the budget within a second that make a flood
# s of a block; doubled with each repeated flood
BLOCK_TIME = 5.0
MAX_BLOCK_TIME = 60.0
KNOWN_TIME = 3.0  # s of datagrams after which a source is known
IDLE_TIME = 5.0  # s of silence after which a source is forgotten
# Sources with budgets of their own: MAX_MEMBERS robots, and 64 operators. Some 2 kB each. The
# kernel's program for all of them has 3,700 of the 4,096 instructions that a filter may have.
MAX_SOURCES = 1088
# places in the kernel's filter
MAX_BLOCKED = 64
MAX_THINNED = 8
MIN_SHARE = 1 / 128  # of urgent datagrams that the filter passes at least
MAX_WEIGHT = 64.0


class FloodRules(Struct, frozen=True):
    """The datagrams that the kernel's filter drops."""

    blocked: tuple[Address, ...] = ()  # sources whose datagrams are dropped unless urgent
    thinned: tuple[tuple[Address, float], ...] = ()  # sources, and the share of urgent that passes
    share: float = 1.0  # the share of urgent datagrams that passes, of sources not in `known`
    only_known: bool = False  # datagrams of sources not in `known` are dropped unless urgent
    known: tuple[Address, ...] = ()

    def shortened(self) -> FloodRules:
        """Rules for a filter of 9 kB, two of which fit what old kernels lend a socket (20 kB)."""
        return replace(self, blocked=self.blocked[:24], known=self.known[:96])


class _Budget:
    """A token bucket that detects a flood: EXCESS datagrams beyond the budget within a second."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate = rate
        self._bucket = TokenBucket(rate, burst)
        self._window = -1e9  # the begin of the present second
        self._count = 0.0  # datagrams within this second
        self._excess = 0.0  # datagrams beyond the budget within this second
        self._block_time = BLOCK_TIME
        self.blocked_until = -1e9
        self.share = 1.0

    def take(self, weight: float, now: float) -> bool:
        """True if one more datagram of this weight is within the budget."""
        if now - self._window > 1.0:
            self._window = now
            self._count = 0.0
            self._excess = 0.0
        self._count += weight
        if self._bucket.take(weight, now):
            return True
        self._excess += weight
        return False

    def begins_flood(self, now: float) -> bool:
        """True if a flood begins now; called after `take` has refused a datagram.

        Then sets `blocked_until`, and `share`: the part of the urgent datagrams to pass meanwhile.
        """
        if self._excess < EXCESS:
            return False
        if now < self.blocked_until:  # the full queue hid a part of the flood
            self._excess = 0.0
            self.share = max(self.share / 4, MIN_SHARE)
            block_began = self.blocked_until - self._block_time
            return self._window > block_began  # a whole second in spite of the kernel's filter
        is_repeated = now - self.blocked_until <= 2 * self._block_time
        self._block_time = min(2 * self._block_time, MAX_BLOCK_TIME) if is_repeated else BLOCK_TIME
        self.blocked_until = now + self._block_time
        rate = self._count / max(now - self._window, 0.01)
        self.share = min(max(self._rate / rate, MIN_SHARE), 1.0)
        return True


class _Source(Struct):
    first: float
    last: float
    is_known: bool = False
    usual: _Budget = field(default_factory=lambda: _Budget(RATE, BURST))
    urgent: _Budget = field(default_factory=lambda: _Budget(URGENT_RATE, BURST))
    own: TokenBucket | None = None  # for rule 4; None before the first datagram, and once known


class FloodLimits:
    """The budgets of all sources; `dropped` counts what they refuse, by kind."""

    def __init__(self) -> None:
        self._sources: dict[Address, _Source] = {}
        self._strangers = _Source(
            *(0.0, 0.0, False),
            usual=_Budget(STRANGERS_RATE, STRANGERS_RATE),
            urgent=_Budget(STRANGERS_RATE, STRANGERS_RATE),
        )
        self._swept = -1e9
        self._rules = FloodRules()
        self._rules_end = 0.0
        self._is_changed = False
        self.dropped: Counter[str] = Counter()

    def admits(self, source: Address, kind: int, now: float, weight: float = 1.0) -> bool:
        """True if a datagram of this kind is within the budgets of its source.

        A datagram of a new source must also be within the shared budget of new sources. `weight`:
        the ratio of arrived to read datagrams, at most MAX_WEIGHT.
        """
        sender = self._place(source, now)
        if sender is not self._strangers:
            self._get_to_know(sender, now)
        owners = [sender]
        if sender is not self._strangers and not sender.is_known:
            is_usual = kind not in URGENT
            if not (is_usual and _is_within_own(sender, weight, now)):
                owners.append(self._strangers)
        for owner in owners:
            budget = owner.urgent if kind in URGENT else owner.usual
            if not budget.take(weight, now):
                self.dropped[f"flood:{_name(kind)}"] += 1
                self._is_changed |= budget.begins_flood(now)
                return False
        return True

    def _get_to_know(self, sender: _Source, now: float) -> None:
        """Mark a source as known once it was heard for KNOWN_TIME.

        The time of a flood of new sources does not count.
        """
        if now - sender.last > IDLE_TIME:
            sender.first = now
            sender.is_known = False
            sender.own = None
        strangers = self._strangers
        if now < max(strangers.usual.blocked_until, strangers.urgent.blocked_until):
            sender.first = now
        sender.last = now
        sender.is_known |= now - sender.first >= KNOWN_TIME
        if sender.is_known:
            sender.own = None

    def rules(self, now: float) -> FloodRules:
        """The rules for the kernel, which stay the same object until they change."""
        if self._is_changed or now >= self._rules_end > 0.0:
            self._is_changed = False
            self._rules = self._make_rules(now)
            ends = [
                budget.blocked_until
                for sender in (*self._sources.values(), self._strangers)
                for budget in (sender.usual, sender.urgent)
                if budget.blocked_until > now
            ]
            self._rules_end = min(ends, default=0.0)
        return self._rules

    def _make_rules(self, now: float) -> FloodRules:
        blocked = []
        thinned = []
        for address, sender in self._sources.items():
            if now < sender.usual.blocked_until:
                blocked.append(address)
            if now < sender.urgent.blocked_until:
                thinned.append((address, sender.urgent.share))
        strangers = self._strangers
        is_thinned = now < strangers.urgent.blocked_until
        is_closed = now < strangers.usual.blocked_until
        known: list[Address] = []
        if is_thinned or is_closed:
            old = [address for address, sender in self._sources.items() if sender.is_known]
            known = [address for address in old if address not in blocked]
        return FloodRules(
            blocked=tuple(blocked[:MAX_BLOCKED]),
            thinned=tuple(thinned[:MAX_THINNED]),
            share=strangers.urgent.share if is_thinned else 1.0,
            only_known=is_closed,
            known=tuple(known),
        )

    def _place(self, source: Address, now: float) -> _Source:
        """The entry of a source; the shared entry of new sources if the table is full."""
        known = self._sources.get(source)
        if known is not None:
            return known
        if len(self._sources) >= MAX_SOURCES and now - self._swept >= 1.0:
            self._swept = now
            self._sources = {
                address: sender
                for address, sender in self._sources.items()
                if now - sender.last <= IDLE_TIME
                or now < max(sender.usual.blocked_until, sender.urgent.blocked_until)
            }
        if len(self._sources) >= MAX_SOURCES:
            return self._strangers
        known = self._sources[source] = _Source(now, now)
        return known


def _is_within_own(stranger: _Source, weight: float, now: float) -> bool:
    """True if a datagram is within the STRANGER_RATE of a new source; the first one never is."""
    if stranger.own is None:
        stranger.own = TokenBucket(STRANGER_RATE, STRANGER_RATE)
        return False
    return stranger.own.take(weight, now)


def _name(kind: int) -> str:
    try:
        return Kind(kind).name.lower()
    except ValueError:
        return "unknown"
