"""The exit codes of swarmctl; `swarmctl --help` explains them.

`Outcome.exit_code` derives the code of a request from the replies.
"""

from __future__ import annotations

from collections.abc import Collection

from swarmd.core.messages import Refusal

APPLIED, FAILED, USAGE, PARTIAL, NO_TARGET, TIMEOUT, UNREACHABLE, REFUSED = range(8)


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
