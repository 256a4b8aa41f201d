"""Asks a robot for the findings of `swarmctl doctor`: no click, no printing."""

from __future__ import annotations

import time
from collections.abc import Iterator
from importlib.metadata import version
from typing import TYPE_CHECKING

from swarmd.core.codec import Decoder
from swarmd.core.errors import CodecError
from swarmd.core.finding import Finding
from swarmd.core.verbs import DOCTOR
from swarmd.operator.session.session import MAX_ANSWER
from swarmd.operator.texts import doctor as findings_of

if TYPE_CHECKING:
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator

LISTEN_TIME = 1.5  # s: each robot sends a beacon a second


def findings_of_robot(
    operator: Operator, view: MembersView, robot: str, timeout: float | None
) -> Iterator[Finding]:
    """Yields the findings about a robot, from a look at the swarm and from its answer to a query.

    `timeout`: the longest wait for the answer in s; None for a robot out of reach, which is not
    queried.
    """
    answer = None
    sent_at = time.time()
    if timeout is not None:
        answer = operator.ask(robot, DOCTOR.name, timeout=timeout)
    returned_at = time.time()
    if answer is None:
        remedy = "see swarmctl members; look at its power, its network and its daemon"
        yield Finding("answer", False, "it does not answer", remedy)
        return
    try:
        reply = Decoder(DOCTOR.answer, MAX_ANSWER)(answer)
    except CodecError as error:
        remedy = "install the same version everywhere"
        yield Finding("answer", False, f"unreadable: {error}", remedy)
        return
    yield findings_of.name(len(view.duplicates.get(robot, (robot,))))
    yield findings_of.round_trip(view.round_trip, view.loss)
    # The robot read its clock between `sent_at` and `returned_at`: in their middle, within half of
    # the time between them.
    answered_at = 0.5 * (sent_at + returned_at)
    yield from findings_of.of_robot(
        reply,
        skew=reply.machine.wall - answered_at,
        error=0.5 * (returned_at - sent_at),
        version=version("swarmd"),
        ways=operator.ways(robot),
        others=len(set(view.alive) - {robot}),
        now=returned_at,
        roster=None if operator.identity is None else operator.identity.roster.generation,
    )
