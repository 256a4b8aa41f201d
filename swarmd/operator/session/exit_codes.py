"""The exit codes of swarmctl, and the rules that decide the code of a command."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

from swarmd.core.refusal import Refusal

if TYPE_CHECKING:
    from swarmd.operator.session.outcome import Outcome

APPLIED, FAILED, USAGE, PARTIAL, NO_TARGET, TIMEOUT, UNREACHABLE, REFUSED = range(8)


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
    """The exit code of a command that only asks robots and changes nothing.

    APPLIED if all robots in `asked` have answered (or `asked` is empty), PARTIAL if some have
    answered, TIMEOUT if no robot has answered.
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
