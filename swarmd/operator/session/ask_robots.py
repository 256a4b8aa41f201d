"""Queries to several robots that change nothing, and the statuses that robots publish."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from msgspec import Struct

from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.messages import Status

if TYPE_CHECKING:
    from queue import SimpleQueue

    from swarmd.core.verbs import Verb
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.session import Session

ASK_TIME = 5.0  # s for an answer, without a timeout
MAX_ANSWER = 512 * 1024  # bytes of an answer, at most


class Answer(Protocol):
    """An answer with the name of its robot."""

    @property
    def robot(self) -> str:
        """The name of the robot in the answer."""
        ...


T = TypeVar("T", bound=Answer)
_status = Decoder(Status)


def ask_robots(
    session: Session, robots: Iterable[str], verb: Verb[Any, T], question: Struct | None = None
) -> dict[str, T]:
    """The answers to a query, by robot. Reports an answer that cannot be read to `session.tell`."""
    decode = Decoder(verb.answer, MAX_ANSWER)
    answers = {}
    payload = b"" if question is None else encode(question)
    timeout = session.timeout or ASK_TIME
    payloads = session.operator.ask_all(robots, verb.name, payload, timeout=timeout)
    for robot, answer in sorted(payloads.items()):
        try:
            read = decode(answer)
        except CodecError as error:
            session.tell(f"{robot}: its answer cannot be read: {error}")
            continue
        if read.robot != robot:
            session.tell(f"{robot}: its answer is in the name of {read.robot}, and is left out")
            continue
        answers[robot] = read
    return answers


@contextmanager
def statuses_of(operator: Operator) -> Iterator[SimpleQueue[Status]]:
    """Subscribe to the statuses of robots within the `with` block; `next_status` reads them."""
    from queue import SimpleQueue

    news: SimpleQueue[Status] = SimpleQueue()

    def on_status(robot: str, payload: bytes) -> None:
        status = _status(payload)
        if status.robot == robot:
            news.put(status)

    operator.watch("status", on_status)
    try:
        yield news
    finally:
        operator.unwatch("status")


def next_status(news: SimpleQueue[Status], seconds: float) -> Status | None:
    """The next status; None if no status comes within `seconds`."""
    from queue import Empty

    try:
        return news.get(timeout=seconds)
    except Empty:
        return None


def in_reach(view: MembersView, robots: Iterable[str]) -> tuple[str, ...]:
    """The robots of a look that can be asked; unreachable robots are not waited for."""
    return tuple(robot for robot in robots if view.is_in_reach(robot))
