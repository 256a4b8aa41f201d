"""What of a running world is kept: its touches counted, and a trace if one is wanted."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.live.pacing import Staggered
from swarmd.sim.trace import TraceBuilder
from swarmd.sim.world.contacts import ContactEpisodes
from swarmd.sim.world.world import World

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderSettings:
    """Whether and how a run is recorded.

    `path`: where the trace goes (None: nowhere); `rate` of its instants in Hz; `seconds` of
    simulation after which it is complete (None: when asked, or at the end). `meta` goes into it.
    """

    path: Path | None = None
    rate: float = 50.0
    seconds: float | None = None
    meta: Mapping[str, object] = field(default_factory=dict)


class LiveRecorder:
    """Follows a world step by step. Recording begins at once, and anew with `begin`."""

    def __init__(self, world: World, settings: RecorderSettings) -> None:
        self._world, self._settings = world, settings
        self._recorder = TraceBuilder(
            world.ids,
            world.platforms,
            settings.meta,
            movable_boxes=world.movable_boxes,
            box_shapes=world.box_shapes,
        )
        self.is_running = False
        self.contacts = 0
        self.arena_contacts = 0
        self._end = 0.0
        self.begin()

    @property
    def seconds(self) -> float:
        """Seconds of simulation since it began, up to where it ended."""
        return (self._world.time if self.is_running else self._end) - self._start

    def begin(self) -> None:
        """Forget what was; the record's time 0 is now."""
        self._start = self._world.time
        self._episodes = ContactEpisodes()
        self._due = Staggered(np.array([self._settings.rate]), self._start)
        self._recorder.clear()
        self.contacts = self.arena_contacts = 0
        self.is_running = True

    def note(self, safe: Array) -> None:
        """Take in the step just made, with the commands (n, 3) in force."""
        if not self.is_running:
            return
        self._note_contacts()
        if self._settings.path is not None and len(self._due.due(self._world.time)):
            world = self._world
            self._recorder.add(self.seconds, world.poses(), safe, world.box_poses())
        if self._settings.seconds is not None and self.seconds >= self._settings.seconds - 1e-9:
            self.finish()

    def finish(self) -> Path | None:
        """End it, and write the trace once; the path, or None if none was wanted."""
        path = self._settings.path
        if self.is_running:
            self._end = self._world.time
            self.is_running = False
            if path is not None:
                self._recorder.trace(seconds=self.seconds).save(path)
                _log.info("%.1f s of simulation written to %s", self.seconds, path)
        return path

    def _note_contacts(self) -> None:
        for touch in self._world.contacts():
            if self._episodes.add(self._world.time, touch.a, touch.b):
                _log.info("%s touches %s at %.2f s", touch.a, touch.b, self.seconds)
                if touch.b in self._world.ids:
                    self.contacts += 1
                else:
                    self.arena_contacts += 1
            if self._settings.path is not None:
                self._recorder.touch(self.seconds, touch.a, touch.b, touch.speed_a, touch.speed_b)
