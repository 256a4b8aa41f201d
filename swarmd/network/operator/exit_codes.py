"""The exit codes of swarmctl, the rules that decide the code of a command, and their help text."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

from swarmd.core.messages import Refusal

if TYPE_CHECKING:
    from swarmd.network.operator.outcome import Outcome

APPLIED, FAILED, USAGE, PARTIAL, NO_TARGET, TIMEOUT, UNREACHABLE, REFUSED = range(8)
EXIT_CODES_HELP = """\b
Exit codes:
  0  all targeted robots applied it
  1  none applied it, and at least one failed
  2  usage, or all that answered know no such pattern or parameter: none moved
  3  partial: some robots applied it, some did not; of a look: some did not answer
  4  no robot was targeted
  5  none applied it or failed, and at least one did not answer in time
  6  no daemon could be reached
  7  all robots refused
  130  interrupted"""


def code_of_outcome(outcome: Outcome) -> int:
    """The code of a request, from the replies of the targeted robots."""
    if not outcome.targeted:
        return NO_TARGET
    if outcome.mistake:
        return USAGE
    is_whole = not outcome.unlisted and not outcome.unlabelled
    if len(outcome.applied) == outcome.targeted and is_whole:
        return APPLIED
    if outcome.applied:
        return PARTIAL
    if outcome.failed:
        return FAILED
    return TIMEOUT if outcome.missing else REFUSED


def code_of_answers(asked: Collection[str], answered: Collection[str]) -> int:
    """The code of a command that only asks: APPLIED if all answered, also if nobody was asked.

    PARTIAL if some answered, TIMEOUT if none did.
    """
    if set(asked) <= set(answered):
        return APPLIED
    return TIMEOUT if set(asked).isdisjoint(answered) else PARTIAL


# Refusals that the operator corrects by writing another command line.
MISTAKES = frozenset(
    {
        Refusal.INVALID_REQUEST,
        Refusal.UNKNOWN_PATTERN,
        Refusal.INVALID_PARAMETER,
        Refusal.INVALID_CONDITION,
    }
)
