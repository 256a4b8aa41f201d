"""Rate limits of the datagrams that a robot sends as answers. Pure.

Five budgets: for all answers together, for each host, for scouts, for claimers of the own id, and
for statuses.
"""

from __future__ import annotations

from swarmd.core.bounds import keep_newest
from swarmd.core.token_bucket import TokenBucket
from swarmd.link.datagram import Address

# Datagrams per second.
# answers to solicits: of all hosts, of one host
ANSWER_RATE = 100.0
ANSWER_RATE_OF_HOST = 30.0
SCOUT_ANSWER_RATE = 20.0  # answers to solicits of any swarm, whose senders need no keys
CLAIM_ANSWER_RATE = 40.0  # answers to claimers of the own id
# Statuses per second, to all hosts: to make and encode one takes longer than a beacon.
STATUS_RATE = 10.0
MAX_HOSTS = 128


class AnswerBudget:
    """Token buckets of answers; each permits as many answers at once as in one second."""

    def __init__(self) -> None:
        self._of_all = TokenBucket(ANSWER_RATE, ANSWER_RATE)
        self._by_host: dict[str, TokenBucket] = {}
        self._of_scouts = TokenBucket(SCOUT_ANSWER_RATE, SCOUT_ANSWER_RATE)
        self._of_claimers = TokenBucket(CLAIM_ANSWER_RATE, CLAIM_ANSWER_RATE)
        self._of_statuses = TokenBucket(STATUS_RATE, STATUS_RATE)

    def may_answer(self, source: Address, count: int, now: float) -> bool:
        """True if `count` datagrams may go to a host now; they are taken from its budget."""
        # All robots of one machine have one host, and a robot behind routers has no port.
        host = f"{source[0]}:{source[1]}" if source[0].startswith("127.") else source[0]
        budget = self._by_host.get(host)
        budget = budget or TokenBucket(ANSWER_RATE_OF_HOST, ANSWER_RATE_OF_HOST)
        keep_newest(self._by_host, host, budget, MAX_HOSTS)
        return budget.take(count, now) and self._of_all.take(count, now)

    def may_answer_scout(self, now: float) -> bool:
        """True if a scout may be answered now; the answer is taken from the budget."""
        return self._of_scouts.take(1.0, now)

    def may_answer_claimer(self, now: float) -> bool:
        """True if a claimer of the id may be answered now; the answer is taken from the budget."""
        return self._of_claimers.take(1.0, now)

    def may_make_status(self, now: float) -> bool:
        """True if a status may be made now to answer with; it is taken from the budget."""
        return self._of_statuses.take(1.0, now)
