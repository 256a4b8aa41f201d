"""A swarm without robots for pages: an operator that is fed the messages of any number of them.

`python -m tests.support.fed_swarm 500 --port 0` serves its page, as `swarmctl view --web` does.
"""

from __future__ import annotations

import argparse
import itertools
import math
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Self

import numpy as np

from swarmd.core.codec import encode
from swarmd.core.errors import unknown
from swarmd.core.messages import (
    Code,
    DecisionSummary,
    Epoch,
    Latch,
    LimitingObstacle,
    Motion,
    Presence,
    Reason,
    Reply,
    State,
    Status,
)
from swarmd.core.refusal import Refusal
from swarmd.core.values import Scan
from swarmd.core.verbs import AnyRequest, RunRequest
from swarmd.driver_api.hw_codec import encode_scan
from swarmd.link.settings import NetworkSettings
from swarmd.operator.cli.web import WebOptions, serve
from swarmd.operator.session.members_view import Dials, MembersView, SeenMember
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.view.commander import LiveCommander
from swarmd.operator.view.live import LiveSource
from tests.support.statuses import make_member, status

PERIOD = 0.1
LAP = 300  # motions of one circle
PATTERNS = ("attraction", "dispersion", "flocking", "drive")


class FedSwarm:
    """`count` robots on circles; those in `silent` acknowledge nothing. Context manager: feeds."""

    def __init__(self, count: int, silent: Collection[str] = ()) -> None:
        self.names = [f"tb3-{i + 1:03d}" for i in range(count)]
        self.silent = set(silent)
        self.left: set[str] = set()  # ended in order
        self.lock = threading.Lock()
        self.states = dict.fromkeys(self.names, State.RUNNING)
        self.changes: dict[str, Mapping[str, Any]] = {}
        """By robot what its status has instead; set by `change`."""
        self.patterns = {name: PATTERNS[i % 3] for i, name in enumerate(self.names)}
        self.watched: dict[tuple[str, str], Callable[[str, bytes], object]] = {}
        self._ending = threading.Event()
        self._made: dict[tuple[str, State, bool, bool], tuple[SeenMember, bytes]] = {}
        self._motions = [[encode(one) for one in self._lap(i)] for i in range(count)]
        self._thread = threading.Thread(target=self._feed, name="feed", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()

    def status(self, name: str) -> Status:
        """What the robot publishes now."""
        state, index = self.states[name], int(name[-3:]) - 1
        reasons = {
            State.IDLE: Reason.RESET,
            State.STOPPED: Reason.OPERATOR,
            State.ESTOPPED: Reason.ESTOP,
        }
        is_running = state is State.RUNNING
        latch = Latch(issuer="anna@desk", scope="swarm", reason="from the page", age=300.0)
        usual: dict[str, Any] = {
            "state": state,
            "reason": reasons.get(state),
            "detail": "" if is_running else "by anna@desk",
            "pattern": self.patterns[name] if is_running else None,
            "latches": {"e1": latch} if state is State.ESTOPPED else {},
            "labels": ("red",) if index % 2 else ("blue",),
            "report": {"opinion": "AB"[index % 2], "votes": index % 7},
            "readings": {"battery": 0.2 + 0.8 * (index % 10) / 10.0},
            "decision": DecisionSummary(
                requested_linear=0.2, safe_linear=0.1, is_active=index % 5 == 0, min_gap=0.4
            ),
        }
        return status(name, **{**usual, **self.changes.get(name, {})})

    def change(self, name: str, state: State, **changes: Any) -> None:
        """Set the state of a robot and other values of its status, and publish it at once."""
        with self.lock:
            self.states[name], self.changes[name] = state, changes
        kept = [one for one in [*self._made.items()] if one[0][0] != name]
        self._made = dict(kept)
        self._publish("status", name, self.member(name)[1])

    def member(self, name: str) -> tuple[SeenMember, bytes]:
        """What an operator sees of the robot, and its status as it is published."""
        made = self._made  # another thread may replace it
        key = name, self.states[name], name in self.silent, name in self.left
        if (found := made.get(key)) is None:
            if key[2] or key[3]:
                presence = Presence.LEFT if key[3] else Presence.FAILED
                member, seen = make_member(name, presence, age=20.0), self.status(name)
            else:
                seen = self.status(name)
                member = make_member(name, **{k: getattr(seen, k) for k in CHANGING})
            made[key] = found = member, encode(seen)
        return found

    def _lap(self, index: int) -> Sequence[Motion]:
        columns = math.ceil(math.sqrt(len(self.names)))
        middle = 1.2 * (index % columns), 1.2 * (index // columns)
        rows = (LimitingObstacle(0.6, 0.25, 0.08),) if index % 5 == 0 else ()
        speed = 0.09 if rows else 0.15
        found = []
        for step in range(LAP):
            angle = 2.0 * math.pi * (step / LAP + index / 7.0)
            found.append(
                Motion(
                    robot=self.names[index],
                    at=step * PERIOD,
                    x=middle[0] + 0.35 * math.cos(angle),
                    y=middle[1] + 0.35 * math.sin(angle),
                    yaw=angle + math.pi / 2.0,
                    requested=(0.15, 0.3, 0.0),
                    safe=(speed, 0.45, 0.0),
                    is_active=bool(rows),
                    gap=0.25 if rows else None,
                    rows=rows,
                )
            )
        return found

    def _feed(self) -> None:
        bearings = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
        ranges = 0.6 + 0.2 * np.cos(3.0 * bearings)
        due = time.monotonic()
        for step in itertools.count():
            for i, name in enumerate(self.names):
                with self.lock:
                    moves = self.states[name] is State.RUNNING and name not in self.changes
                self._publish("motion", name, self._motions[i][step % LAP if moves else 0])
                if step % 10 == i % 10:
                    self._publish("status", name, self.member(name)[1])
            if step % 2 == 0:
                for _, name in [key for key in [*self.watched] if key[0] == "scan"]:
                    scan = Scan(step, step * PERIOD, ranges, bearings, 0.12, 3.5)
                    self._publish("scan", name, encode_scan(scan))
            due = max(due + PERIOD, time.monotonic())
            if self._ending.wait(due - time.monotonic()):
                return

    def _publish(self, what: str, name: str, payload: bytes) -> None:
        for key in ((what, "*"), (what, name)):
            if handler := self.watched.get(key):
                handler(name, payload)


class FedOperator:
    """In the place of an `Operator` of a `FedSwarm`."""

    name, identity = "anna@laptop", None

    def __init__(self, swarm: FedSwarm) -> None:
        self.settings = NetworkSettings(swarm="fed")
        self.notices: list[str] = []
        self._swarm = swarm

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""

    def watch(self, name: str, handler: Callable[[str, bytes], object], robot: str = "*") -> None:
        self._swarm.watched[name, robot] = handler

    def unwatch(self, name: str, robot: str = "*") -> None:
        self._swarm.watched.pop((name, robot), None)

    def expect(self, names: Collection[str]) -> None:
        """All are known."""

    def update_roster(self) -> bool:
        return False

    def seen(self) -> MembersView:
        return self.members()

    def links(self) -> frozenset[tuple[str, str]]:
        """Each robot hears the next one."""
        return frozenset(itertools.pairwise(self._swarm.names))

    def members(
        self, *, timeout: float | None = None, needs_status: bool = True, dials: Dials = Dials.ALL
    ) -> MembersView:
        swarm = self._swarm
        found = {name: swarm.member(name)[0] for name in swarm.names}
        return MembersView(found, answered=frozenset(set(found) - swarm.silent))

    def request(
        self, kind: type[AnyRequest], targets: Mapping[str, Epoch | None], **fields: Any
    ) -> Outcome:
        if kind is RunRequest and (refused := self._refused(targets, fields["pattern"])):
            return Outcome(refused, reached=len(refused))
        state = State.RUNNING if kind is RunRequest else State.IDLE
        for name in targets:
            if name not in self._swarm.silent and kind.__name__ != "ParamRequest":
                with self._swarm.lock:
                    self._swarm.states[name] = state
        return self._outcome(targets)

    def _refused(self, targets: Collection[str], pattern: str) -> dict[str, Reply]:
        """The replies to a run if robots refuse it: of an unknown pattern, or estopped."""
        texts = {
            name: (Refusal.ESTOPPED, "estopped (estop) by anna@desk; reset it first")
            for name in targets
            if self._swarm.states[name] is State.ESTOPPED
        }
        if pattern not in PATTERNS:
            text = unknown("pattern", pattern, PATTERNS)
            texts = dict.fromkeys(targets, (Refusal.UNKNOWN_PATTERN, text))
        return {
            name: Reply(id="1", robot=name, code=Code.REFUSED, refusal=refusal, text=text)
            for name, (refusal, text) in texts.items()
        }

    def send_stop(
        self,
        verb: str,
        *,
        select: Callable[[Collection[str]], Collection[str]] | None = None,
        until_all: bool = False,
        on_progress: Callable[[tuple[str, ...]], None] = lambda missing: None,
        is_ended: Callable[[], bool] = lambda: False,
        **_: Any,
    ) -> Outcome:
        swarm = self._swarm
        targets = swarm.names if select is None else select(swarm.names)
        shown: set[str] = set()
        while True:
            for name in set(targets) - swarm.silent:
                with swarm.lock:
                    swarm.states[name] = State.ESTOPPED if verb == "estop" else State.STOPPED
            missing = set(targets) & swarm.silent
            if not missing or not until_all or is_ended():
                return self._outcome(targets)
            if missing != shown:
                on_progress(tuple(sorted(missing)))
                shown = missing
            time.sleep(0.02)

    def _outcome(self, targets: Collection[str]) -> Outcome:
        missing = tuple(sorted(set(targets) & self._swarm.silent))
        answered = [name for name in targets if name not in missing]
        replies = {name: Reply(id="1", robot=name, code=Code.APPLIED) for name in answered}
        if len(replies) > 100:
            name = max(answered)  # the page lists robots in the order in which it heard them
            replies[name] = Reply(
                id="1", robot=name, code=Code.REFUSED, refusal=Refusal.BUSY, text="busy"
            )
        return Outcome(replies, missing, reached=len(answered))


CHANGING = (
    *("state", "reason", "detail", "pattern", "latches", "labels", "report"),
    *("readings", "decision", "health"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--silent", nargs="*", default=[])
    parser.add_argument("--viewer-token", default="")
    options = parser.parse_args()
    with FedSwarm(options.count, options.silent) as swarm:
        made: Any = FedOperator
        source = LiveSource(made(swarm), PATTERNS)
        commander = LiveCommander(lambda: made(swarm), source.expected)
        token = "operator-token" if options.viewer_token else ""
        source.start()
        try:
            web = WebOptions("127.0.0.1", options.port, token, options.viewer_token)
            serve(source, commander, web)
        finally:
            commander.close()
            source.close()


if __name__ == "__main__":
    main()
