"""One owner for each robot id: the two-phase claim, and the watch for a second owner later.

A daemon declares the token `claim/<instance>`, listens for rivals, and waits until discovery has
settled. The smaller claimer wins and declares `alive/<instance>`; the other is refused. Asking
first and declaring then let two owners through in 6 of 12 trials, this let one through in 80 of
80. A foreign `alive` may be what is left of a machine that lost power: it is waited for, at most
the lease and a second. Two owners can still come together, when a cut heals: the watch tells.

Use::

    claim = await claim_id(session, swarm="lab", robot="tb3-01", instance=boot,
                           settle=settings.settle, lease=settings.lease_seconds,
                           on_duplicate=robot_is_held_by)   # called on the loop, with the instance
    ...
    claim.release()      # drops the alive token; publish `left` before
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import zenoh

from swarmd.clock import Clock, boottime
from swarmd.errors import IdHeldError
from swarmd.handover import hand_over
from swarmd.keys import ANY, build, parse
from swarmd.network.session import undeclare

MAX_RIVALS = 64

Phase = Literal["alive", "claim"]


@dataclass(slots=True)
class Rivals:
    """Pure: the other instances that hold or claim this id, and what that means for `own`.

    `changed_at` is when the picture last changed, `claimed` all that were ever seen to claim.
    """

    own: str
    changed_at: float
    alive: dict[str, float] = field(default_factory=dict)
    claiming: dict[str, float] = field(default_factory=dict)
    claimed: set[str] = field(default_factory=set)

    def on_token(self, phase: Phase, instance: str, is_there: bool, now: float) -> None:
        """A rival's token appeared or vanished."""
        if instance == self.own:
            return
        table = self.alive if phase == "alive" else self.claiming
        if not is_there:
            table.pop(instance, None)
        elif len(table) < MAX_RIVALS:
            table.setdefault(instance, now)
        if phase == "claim" and is_there and len(self.claimed) < MAX_RIVALS:
            self.claimed.add(instance)
        self.changed_at = now

    @property
    def holder(self) -> str | None:
        """The instance that stands in the way now: an owner, or a smaller claimer."""
        if self.alive:
            return min(self.alive)
        smaller = [instance for instance in self.claiming if instance < self.own]
        return min(smaller) if smaller else None

    @property
    def has_lost(self) -> bool:
        """True once a rival that was seen to claim has become the owner: no leftover, then."""
        return any(instance in self.claimed for instance in self.alive)

    def is_won(self, settle: float, now: float) -> bool:
        """True once nobody has stood in the way for `settle` seconds."""
        return self.holder is None and now - self.changed_at >= settle


class Claim:
    """A robot id that is ours: holds the alive token and watches for a second owner."""

    def __init__(
        self, alive: zenoh.LivelinessToken, watch: zenoh.Subscriber[None], rivals: Rivals
    ) -> None:
        self._alive = alive
        self._watch = watch
        self._rivals = rivals

    @property
    def duplicates(self) -> Mapping[str, float]:
        """Other instances that own this id now, and since when."""
        return dict(self._rivals.alive)

    def release(self) -> None:
        """Give the id up; publish `left` before. Harmless on a closed session."""
        undeclare(self._watch, self._alive)


async def claim_id(
    session: zenoh.Session,
    *,
    swarm: str,
    robot: str,
    instance: str,
    settle: float,
    lease: float,
    on_duplicate: Callable[[str], object],
    clock: Clock = boottime,
) -> Claim:
    """The claim on `robot`, won; IdHeldError in one line naming the holder if it is taken."""
    loop = asyncio.get_running_loop()
    rivals = Rivals(own=instance, changed_at=clock())
    news = asyncio.Event()
    is_owner = False

    def on_loop(phase: Phase, other: str, is_there: bool) -> None:
        is_new = phase == "alive" and is_there and other not in rivals.alive
        rivals.on_token(phase, other, is_there, clock())
        news.set()
        if is_owner and is_new and other in rivals.alive:
            on_duplicate(other)

    def on_token(sample: zenoh.Sample) -> None:
        key = parse(str(sample.key_expr))
        if key is None or (key.swarm, key.robot) != (swarm, robot):
            return
        if key.plane == "alive":
            hand_over(loop, on_loop, "alive", key.name, sample.kind == zenoh.SampleKind.PUT)
        elif key.plane == "claim":
            hand_over(loop, on_loop, "claim", key.name, sample.kind == zenoh.SampleKind.PUT)

    liveliness = session.liveliness()
    watch = liveliness.declare_subscriber(build(swarm, robot, ANY, ANY), on_token, history=True)
    claiming = liveliness.declare_token(build(swarm, robot, "claim", instance))
    try:
        await _win(rivals, news, settle=settle, patience=lease + 1.0, clock=clock, robot=robot)
        alive = liveliness.declare_token(build(swarm, robot, "alive", instance))
        is_owner = True
    except BaseException:
        undeclare(watch)
        raise
    finally:
        undeclare(claiming)
    return Claim(alive, watch, rivals)


async def _win(
    rivals: Rivals, news: asyncio.Event, *, settle: float, patience: float, clock: Clock, robot: str
) -> None:
    deadline: float | None = None
    while True:
        now = clock()
        if rivals.is_won(settle, now):
            return
        holder = rivals.holder
        if holder is None:
            wait = rivals.changed_at + settle - now
        else:
            deadline = now + patience if deadline is None else deadline
            wait = deadline - now
            if rivals.has_lost or wait <= 0.0:
                raise IdHeldError(
                    f"robot id {robot!r} is held by another daemon (instance {holder});"
                    " stop it, or give this one another id"
                )
        news.clear()
        try:
            async with asyncio.timeout(max(wait, 0.001)):
                await news.wait()
        except TimeoutError:
            continue
