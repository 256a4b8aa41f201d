"""Recording of a live run: contact counts and, if wanted, a trace with the robots' statuses."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec.structs import astuple
from numpy.typing import NDArray

from swarmd.core.messages import Status
from swarmd.core.values import Array
from swarmd.sim.live.pacing import Staggered
from swarmd.sim.live.state import WorldOptions
from swarmd.sim.trace import (
    DECISION_ARRAYS,
    NAMED,
    NO_DECISION,
    Trace,
    TraceBuilder,
    blank_decisions,
    enter_decision,
    enter_named,
)
from swarmd.sim.world.contacts import EPISODE_GAP, ContactEpisodes

if TYPE_CHECKING:  # its simulator takes 80 ms to load
    from swarmd.sim.world.world import World

_log = logging.getLogger(__name__)


class LiveRecorder:
    """Records a world step by step, from its creation or the last `begin` on."""

    def __init__(self, world: World, options: WorldOptions, meta: Mapping[str, object]) -> None:
        """`options`: where to write the trace, its rate and its end. `meta`: of the trace."""
        self._world = world
        self._options = options
        self._builder = TraceBuilder(
            world.ids,
            world.platforms,
            meta,
            movable_boxes=world.loose,
            box_shapes=world.loose_shapes,
        )
        self.is_running = False
        self.contacts = 0
        self.arena_contacts = 0
        self._end = 0.0
        self._touched: dict[tuple[str, str], float] = {}
        self.begin()

    @property
    def seconds(self) -> float:
        """Seconds of simulation recorded so far."""
        return (self._world.time if self.is_running else self._end) - self._start

    def touching(self) -> tuple[tuple[str, str], ...]:
        """The pairs that were in contact in the last EPISODE_GAP s; empty while not recording."""
        since = self._world.time - EPISODE_GAP
        self._touched = {pair: time for pair, time in self._touched.items() if time >= since}
        return tuple(self._touched)

    def begin(self) -> None:
        """Discard the recording and start a new one at time 0."""
        self._start = self._world.time
        self._episodes = ContactEpisodes()
        self._touched = {}
        self._due = Staggered(np.array([self._options.trace_rate]), self._start)
        self._builder.clear()
        self.contacts = 0
        self.arena_contacts = 0
        self.is_running = True

    def note(self, safe: Array) -> None:
        """Record the last step, with the commands (n, 3) in force."""
        if not self.is_running:
            return
        self._note_contacts()
        if self._options.trace is not None and len(self._due.due(self._world.time)):
            world = self._world
            self._builder.add(self.seconds, world.poses(), safe, world.loose_poses())
        if self._options.seconds is not None and self.seconds >= self._options.seconds - 1e-9:
            self.finish()

    def finish(self) -> Path | None:
        """Stop recording and write the trace once; returns its path, None without one."""
        path = None if self._options.trace is None else Path(self._options.trace)
        if self.is_running:
            self._end = self._world.time
            self.is_running = False
            if path is not None:
                self._builder.trace(seconds=self.seconds).save(path)
                _log.info("%.1f s of simulation written to %s", self.seconds, path)
        return path

    def _note_contacts(self) -> None:
        for contact in self._world.contacts():
            self._touched[contact.a, contact.b] = self._world.time
            if self._episodes.add(self._world.time, contact.a, contact.b):
                _log.info("%s touches %s at %.2f s", contact.a, contact.b, self.seconds)
                if contact.b in self._world.ids:
                    self.contacts += 1
                else:
                    self.arena_contacts += 1
            if self._options.trace is not None:
                self._builder.add_contact(self.seconds, *astuple(contact))


class StatusLog:
    """Statuses as an operator received them; each holds until the next."""

    def __init__(self) -> None:
        self._received: list[tuple[float, Mapping[str, Status]]] = []
        self._present: list[tuple[float, frozenset[str]]] = []

    def add(self, time: float, statuses: Mapping[str, Status]) -> None:
        """Add the statuses received at `time` s of the recording; in order of time."""
        self._received.append((time, dict(statuses)))

    def add_present(self, time: float, robots: Collection[str]) -> None:
        """Note which robots have a daemon from `time` s of the recording on.

        Calls must come in the order of `time`. The first call counts from the start of the
        recording.
        """
        self._present.append((time if self._present else 0.0, frozenset(robots)))

    def merged_into(self, trace: Trace) -> Trace:
        """The trace with the state, protection, `report`, `readings` and `words` of the statuses.

        `report` has the numbers that patterns report, `words` their texts. Each status holds until
        the next. Values are empty, False or NaN before a robot's first status, and while the robot
        has no daemon. The requested command is left out: the status is some tenths of a second
        older than the safe command that the world records, so the two commands do not match.
        """
        if not self._received:
            return trace
        shape = len(trace.t), len(trace.ids)
        known: dict[str, Any] = blank_decisions(shape)
        named: dict[str, dict[str, NDArray[Any]]] = {kind: {} for kind in NAMED}
        said: dict[tuple[str, float, str], float] = {}
        for time, statuses in self._received:
            said |= {
                (name, event.at, event.text): round(time - status.uptime + event.at, 3)
                for name, status in statuses.items()
                for event in status.events
            }
            since = int(np.searchsorted(trace.t, time - 1e-9))
            for robot, status in statuses.items():
                if robot not in trace.ids:
                    continue
                place = slice(since, None), trace.ids.index(robot)
                state = status.state.value
                reason = status.reason or ""
                enter_decision(known, place, state, reason, status.decision)
                enter_named(named, place, shape, status)
        known |= {kind: dict(sorted(arrays.items())) for kind, arrays in named.items()}
        if any("fault" in event["action"] for event in trace.meta.get("events", ())):
            lines = sorted((time, name, text) for (name, _, text), time in said.items())
            known["meta"] = {**trace.meta, "said": lines}
        return replace(trace, **known, **self._presence(trace, known))

    def _presence(self, trace: Trace, known: Mapping[str, Any]) -> dict[str, Any]:
        """The array `present` of the trace (instants, robots); {} if all daemons always ran.

        Blanks in `known` the values of robots at instants without a daemon.
        """
        everyone = frozenset(trace.ids)
        if all(robots >= everyone for _, robots in self._present):
            return {}
        present = np.ones((len(trace.t), len(trace.ids)), dtype=bool)
        for time, robots in self._present:
            since = int(np.searchsorted(trace.t, time - 1e-9))
            present[since:] = [robot in robots for robot in trace.ids]
        for name, blank in zip(DECISION_ARRAYS, NO_DECISION, strict=True):
            known[name][~present] = blank
        for kind, blank in NAMED.items():
            for values in known[kind].values():
                values[~present] = blank
        return {"present": present}
