"""What a bus is: how one robot speaks with the others, whatever carries it.

`ZenohBus` (`bus.py`) is one. No Zenoh here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from swarmd.keys import Key
from swarmd.messages import Member, Status, View

# The planes whose puts reach a robot at its own key; all others are heard from other robots.
SAFETY = "safety"


class Query(Protocol):
    """A question or order put to this robot, on its own key."""

    payload: bytes

    def reply(self, payload: bytes) -> None:
        """Answer it, at most once, now or later, on the loop; never blocks, never raises."""

    def drop(self) -> None:
        """Do not answer: the asker is told that nothing more comes. Harmless after `reply`."""


Listener = Callable[[Key, bytes], None]
Server = Callable[[Query], None]
MemberListener = Callable[[Member], None]
StatusListener = Callable[[Status], None]


class Bus(Protocol):
    """One robot's ear and mouth. All handlers run on the loop's thread.

    Samples and queries whose key is not a concrete key that was asked for are dropped and
    counted in `dropped`, by kind; so is what exceeds the queue between network and loop.
    """

    robot: str

    @property
    def dropped(self) -> Mapping[str, int]:
        """What was dropped so far, by kind, such as `control/run:key`."""

    @property
    def members(self) -> Mapping[str, Member]:
        """The other robots that were ever seen and not forgotten, by id."""

    def publish(self, plane: str, name: str, payload: bytes, *, express: bool = False) -> None:
        """Say something on this robot's own key; dropped where a link is congested."""

    def listen(self, plane: str, name: str, handler: Listener) -> None:
        """Hear other robots' keys `<plane>/<name>`; each chunk of `name` may be `*`."""

    def serve(self, plane: str, name: str, handler: Server) -> None:
        """Answer queries on this robot's own key; in plane `safety` also take plain puts."""

    def serve_view(self, status: Callable[[], Status], roster: tuple[str, ...] = ()) -> None:
        """Answer `state/status` and `control/members` from `status()` and the membership."""

    def view(self, status: Status, roster: tuple[str, ...] = ()) -> View:
        """What `control/members` answers: `status` is this robot's own."""

    def on_member(self, callback: MemberListener) -> None:
        """Be told of each member that came, went, left, or was replaced by a new instance."""

    def on_status(self, callback: StatusListener) -> None:
        """Be told of each status that another robot publishes on its own key."""

    def forget(self, robot: str) -> bool:
        """Take a robot that is not alive off the list; False if there is none such."""

    async def ask(
        self, plane: str, name: str, payload: bytes = b"", *, timeout: float = 1.0
    ) -> list[tuple[str, bytes]]:
        """Other robots' answers as (robot, payload): all that come within `timeout` s."""

    def drop(self, kind: str, count: int = 1) -> None:
        """Count something that could not be read, such as `control/run:malformed`."""

    def close(self) -> None:
        """Fall silent at once. Publish `left` before; handlers are not called afterwards."""
