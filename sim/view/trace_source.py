"""Recorded runs of experiments, demos and files on the page, where their traces play."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Array, Platform
from swarmd.operator.texts.values import quantity
from swarmd.operator.texts.why import standing_of
from swarmd.operator.verbs.events.feed import EventLine, together
from swarmd.operator.view.playback import Playback
from swarmd.operator.view.source import ShownArena, ShownRobot, points_of
from swarmd.settings.layered import Layered
from swarmd.settings.platforms import load_platform, platform_of
from swarmd.sim.experiments.manifest import NAME as MANIFEST
from swarmd.sim.experiments.results import load_results
from swarmd.sim.experiments.store import trace_path
from swarmd.sim.metrics.aggregation import cluster_link
from swarmd.sim.metrics.contacts import TraceContact, contact_list
from swarmd.sim.metrics.window import arena_of, presence
from swarmd.sim.scenarios.environment import fields_of
from swarmd.sim.trace import Trace, faults_at, load_trace, patterns_of, poses_at, said_in
from swarmd.sim.view.shown import links_within, shown_arena
from swarmd.sim.world.lidar import RangeSensors
from swarmd.sim.world.scalar_fields import Field

CONTACT_TIME = 1.0
"""Seconds for which a contact is shown after its last step: rows go to the page twice a second."""
MAX_EVENTS = 20
MAX_MARKS = 400
_NO_LINKS: Sequence[tuple[int, int]] = ()


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """A trace with the scenario's fields and its platforms by name, which a trace does not hold."""

    trace: Trace
    fields: Sequence[Field] = ()
    platforms: Mapping[str, Platform] = field(default_factory=dict)
    report_units: Mapping[str, str] = field(default_factory=dict)  # by the keys of reports


class TraceSource:
    """Shows one of several runs; see `swarmd.operator.view.source.Source`."""

    kind = "run"
    patterns: Sequence[str] = ()
    programs: Sequence[str] = ()

    def __init__(
        self,
        title: str,
        runs: Sequence[str],
        load: Callable[[str], RecordedRun],
        first: str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`load` gives the run of a name, and may take a second. SwarmError as `load(first)`."""
        self.swarm = title
        self._load = load
        self.playback = Playback(runs, self._choose, clock)
        self.revision = 0
        self._shown = _ShownRun(load(first))
        self.playback.load(first, self._shown.duration)

    def _choose(self, run: str) -> None:
        shown = _ShownRun(self._load(run))
        self._shown = shown
        self.playback.load(run, shown.duration)
        self.revision += 1

    @property
    def descriptions(self) -> Mapping[str, Mapping[str, Any]]:
        """By pattern: `report_units`, the units of its reports."""
        return self._shown.descriptions

    @property
    def robots(self) -> Sequence[ShownRobot]:
        """The robots of the run."""
        return self._shown.robots

    @property
    def arena(self) -> ShownArena | None:
        """The arena of the run."""
        return self._shown.arena

    @property
    def link(self) -> float | None:
        """The distance within which the metric `clusters` links two robots."""
        return self._shown.link

    def marks(self) -> Sequence[tuple[float, str, Sequence[str]]]:
        """Contacts, changes of states and the events of the scenario."""
        return self._shown.marks

    def frame(self) -> tuple[float, Array]:
        """Poses at the present time, interpolated."""
        now = self.playback.time
        return now, self._shown.places(now)

    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        """What each robot reported at the present time."""
        return self._shown.rows(self.playback.time)

    def scan(self, name: str) -> Array | None:
        """The points that an ideal lidar measures: traces have no scans."""
        return self._shown.scan(name, self.playback.time)

    def boxes(self) -> Sequence[tuple[Array, Sequence[float]]]:
        """The movable boxes that are in the arena."""
        return self._shown.boxes(self.playback.time)

    def links(self) -> Sequence[tuple[int, int]]:
        """Robots within the range of the radio; empty if each hears all."""
        return self._shown.links(self.playback.time)

    def detail(self, name: str) -> Mapping[str, Any] | None:
        """The values of one robot, and its contacts until now."""
        return self._shown.detail(name, self.playback.time)

    def select(self, names: Sequence[str]) -> None:
        """No effect: the values of all robots are known."""


class _ShownRun:
    """One recorded run as the page shows it; times are in s from its start."""

    def __init__(self, run: RecordedRun) -> None:
        """Prepare robots, arena and marks.

        Scans are shown if this machine knows the platforms of all robots.
        """
        trace = run.trace
        self._trace = run.trace
        self.robots = [
            ShownRobot(name, i, trace.platforms[i], trace.footprint(i))
            for i, name in enumerate(trace.ids)
        ]
        arena = arena_of(trace)
        self.arena = None if arena is None else shown_arena(arena, run.fields)
        self.duration = trace.duration
        self._start = float(trace.t[0]) if len(trace.t) else 0.0
        self._t = trace.t - self._start
        self._contacts = contact_list(trace, CONTACT_TIME)
        self._present = presence(trace)
        self._names, self._patterns = patterns_of(trace)
        self._units = run.report_units
        description = {"report_units": run.report_units}  # the same for each pattern
        self.descriptions: Mapping[str, Mapping[str, Any]] = dict.fromkeys(self._names, description)
        self._limits = _largest(trace)  # (3,) the largest speeds, for the scale of a dial
        self._index = {name: i for i, name in enumerate(trace.ids)}
        self.link = cluster_link(trace)  # m, within which two robots are in one cluster
        self.marks = self._marks()

        self._platforms = _known_platforms(run)
        # Ideal lidars, which give the scans: a trace has no scans. None: no scans are shown.
        self._sensors: RangeSensors | None = None
        if arena is not None and self._platforms:
            visibility = trace.meta.get("lidar_visibility", "body")
            # Visibility `real` needs the heights of bodies and lidars. A platform file on this
            # machine may lack these heights, since it may be another file than that of the run.
            with suppress(ConfigError):
                self._sensors = RangeSensors(self._platforms, arena, visibility)

    def places(self, now: float) -> Array:
        """Rows (k, 4) of index and pose of the robots in the arena at a time in s."""
        if not len(self._t):
            return np.zeros((0, 4))
        poses = poses_at(self._t, self._trace.pose, now)
        known = np.flatnonzero(np.isfinite(poses).all(axis=1))
        return np.column_stack((known, poses[known]))

    def rows(self, now: float) -> dict[str, dict[str, Any]]:
        """The row of each robot."""
        if not len(self._t):
            return {}
        at = self._at(now)
        trace = self._trace
        reports: list[dict[str, Any]] = [{} for _ in trace.ids]
        readings: list[dict[str, Any]] = [{} for _ in trace.ids]
        for rows_of, arrays in ((reports, trace.report), (readings, trace.readings)):
            for name, values in arrays.items():
                for i in np.flatnonzero(np.isfinite(values[at])).tolist():
                    rows_of[i][name] = round(float(values[at, i]), 4)
        for name, words in trace.words.items():
            for i in np.flatnonzero(words[at] != "").tolist():
                reports[i][name] = str(words[at, i])
        touched = self._touched(now)
        rows = {}
        for i, name in enumerate(trace.ids):
            row = rows[name] = self._row(at, i)
            row["report"] = reports[i]
            row["readings"] = readings[i]
            row["touches"] = touched.get(name, "")
        return rows

    def scan(self, name: str, now: float) -> Array | None:
        """Points (k, 2) in the base frame that an ideal lidar measures."""
        i = self._index.get(name)
        trace = self._trace
        if self._sensors is None or i is None or not len(self._t):
            return None
        at = self._at(now)
        bodies = [trace.pose[at]] + ([] if trace.box_pose is None else [trace.box_pose[at]])
        if not np.isfinite(trace.pose[at, i]).all():
            return np.zeros((0, 2))
        (ranges,) = self._sensors.cast(np.concatenate(bodies), np.array([i]))
        spec = self._platforms[i].scan
        return points_of(ranges, spec.bearings, spec.offset)

    def boxes(self, now: float) -> list[tuple[Array, Sequence[float]]]:
        """Outlines and poses of the movable boxes in the arena."""
        trace = self._trace
        if trace.box_pose is None or trace.box_shapes is None or not len(self._t):
            return []
        poses = trace.box_pose[self._at(now)]
        shapes = zip(trace.box_shapes, poses, strict=True)
        return [(shape, pose.tolist()) for shape, pose in shapes if np.isfinite(pose).all()]

    def links(self, now: float) -> Sequence[tuple[int, int]]:
        """Pairs of robots within the range of the radio."""
        reach = (self._trace.meta.get("radio") or {}).get("range")
        if reach is None or not len(self._t):
            return _NO_LINKS
        at = self._at(now)
        there = np.flatnonzero(self._present[at])
        return links_within(reach, there, self._trace.pose[at, there, :2])

    def detail(self, name: str, now: float) -> Mapping[str, Any] | None:
        """Values of one robot, and its last contacts, the last first."""
        index = self._index.get(name)
        if index is None or not len(self._t):
            return None
        row = self.rows(now)[name]
        values = [["Platform", self._trace.platforms[index]], ["Pattern", row["pattern"] or "-"]]
        if fault := faults_at(self._trace, now).get(name):
            values.append(["Fault", fault])
        units = self._units
        values += [[f"Report {k}", quantity(v, units.get(k))] for k, v in row["report"].items()]
        values += [[f"Reading {key}", _short(value)] for key, value in row["readings"].items()]
        if self._sensors is not None:
            values.append(["Scan", "ideal: computed from positions, without noise"])
        touches = [(c.start - self._start, _partner(c, name)) for c in self._contacts]
        events = [
            [f"{at:.1f} s", f"touches {partner}"]
            for at, partner in touches
            if partner and at <= now
        ]
        events += [
            [f"{at:.1f} s", text]
            for at, robot, text in said_in(self._trace)
            if robot == name and at <= now
        ]
        events.sort(key=lambda event: float(event[0].split()[0]))
        return {"values": values, "events": events[::-1][:MAX_EVENTS]}

    def _marks(self) -> list[tuple[float, str, Sequence[str]]]:
        ids = self._trace.ids
        state = self._trace.state
        lines = [
            EventLine(c.start - self._start, c.a, "event", f"touches {_partner(c, c.a)}")
            for c in self._contacts
        ]
        for event in self._trace.meta.get("events", ()):
            text = " ".join(filter(None, (event["action"], event.get("pattern"))))
            robots = event.get("robots") or ids
            lines += [EventLine(float(event["at"]), robot, "event", text) for robot in robots]
        lines += [EventLine(at, robot, "event", text) for at, robot, text in said_in(self._trace)]
        if state is not None and len(self._t):
            for at, i in np.argwhere(state[1:] != state[:-1]).tolist():
                word = str(state[at + 1, i])
                lines.append(EventLine(float(self._t[at + 1]), ids[i], "event", word))
        marks = together(lines)[:MAX_MARKS]
        return [(round(line.at, 2), line.text, robots) for line, robots in marks]

    def _at(self, now: float) -> int:
        return min(int(np.searchsorted(self._t, now)), len(self._t) - 1)

    def _row(self, at: int, i: int) -> dict[str, Any]:
        """The values of robot `i` at instant `at`, as the page takes them (see `Source.rows`).

        `near`: the gap to the nearest obstacle in m. `rows`: the strongest speed limit of
        protection. A value that the trace lacks is left out, empty or None.
        """
        trace = self._trace
        is_present = bool(self._present[at, i])
        state = "running" if trace.state is None else str(trace.state[at, i])
        reason = "" if trace.reason is None else str(trace.reason[at, i])
        bound = _finite(trace.bound, at, i)
        requested = _finite(trace.requested, at, i)
        gap = _finite(trace.gap, at, i)
        row: dict[str, Any] = {
            "presence": "alive" if is_present else "absent",
            "state": state if is_present else "",
            "why": reason.replace("_", " ") if is_present else "no daemon at this time",
            # Why a running robot stands: `at rest` by its pattern, or `held`; empty if it moves.
            "stands": standing_of(state, reason) if is_present else "",
            "pattern": self._names[self._patterns[at, i]] if state == "running" else "",
            "limits": self._limits,
            "safe": _rounded(trace.safe[at, i]),
            "protection": self._protection_word(at, i, state),
            "rows": [] if bound is None else [_rounded(bound)],
        }
        if requested is not None:
            row["requested"] = _rounded(requested)
        row["near"] = None if gap is None else round(float(gap), 3)
        return row

    def _protection_word(self, at: int, i: int, state: str) -> str:
        """What protection did: `recovering`, `active` or `clear`; empty if unknown, or not running.

        Protection that recovers leads the robot around an obstacle.
        """
        active = self._trace.active
        recovering = self._trace.recovering
        if recovering is not None and recovering[at, i]:
            return "recovering"
        if active is None or state != "running":
            return ""
        return "active" if active[at, i] else "clear"

    def _touched(self, now: float) -> dict[str, str]:
        time = now + self._start + 1e-9
        partners = {}
        for contact in self._contacts:
            if contact.start <= time <= contact.end + CONTACT_TIME:
                partners[contact.a] = _partner(contact, contact.a)
                if contact.kind == "robot":
                    partners[contact.b] = contact.a
        return partners


def _known_platforms(run: RecordedRun) -> list[Platform]:
    """The platform of each robot; empty if a platform of the run is not known on this machine."""
    names = run.trace.platforms
    try:
        loaded = {name: run.platforms.get(name) or load_platform(name) for name in set(names)}
    except ConfigError:
        return []
    return [loaded[name] for name in names]


def _finite(values: Array | None, at: int, i: int) -> Any:
    """The value of robot `i` at instant `at`; None if the trace has no finite value."""
    if values is None or not np.isfinite(values[at, i]).all():
        return None
    return values[at, i]


def _partner(contact: TraceContact, robot: str) -> str:
    """The partner of a robot in a contact; empty for a contact of other robots."""
    if contact.a == robot:
        return f"box {contact.b}" if contact.kind == "box" else contact.b
    return contact.a if contact.kind == "robot" and contact.b == robot else ""


def _largest(trace: Trace) -> list[float]:
    """The largest absolute linear, angular and lateral speed of all commands of the run.

    The page scales its dial of commands by these speeds. Each is at least 0.01.
    """
    commands = [trace.safe] if trace.requested is None else [trace.safe, trace.requested]
    values = np.concatenate([array.reshape(-1, 3) for array in commands])
    values = np.abs(values[np.isfinite(values).all(axis=1)])
    largest = np.maximum(values.max(axis=0) if len(values) else np.ones(3), 0.01)
    return [float(value) for value in largest]


def _rounded(values: Array) -> list[float]:
    return [round(value, 4) for value in values.tolist()]


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


DEMO_TRACE = "trace.npz"


class Runs(NamedTuple):
    """Recorded runs: their names, and `load`, which gives the run of a name."""

    title: str
    names: Sequence[str]
    load: Callable[[str], RecordedRun]
    first: str


def source_of(place: Path, seed: int | None = None, variant: str | None = None) -> TraceSource:
    """The runs of `runs_of` for the page, which shows `Runs.first` first.

    ConfigError if there is no trace, no such run, or a damaged trace.
    """
    return TraceSource(*runs_of(place, seed, variant))


def runs_of(place: Path, seed: int | None = None, variant: str | None = None) -> Runs:
    """The recorded runs of an experiment's folder, of a demo's folder, or of a trace file.

    `Runs.first` names the first run with this `seed` and `variant`. `seed` None: any seed;
    `variant` None: any variant. ConfigError if there is no trace, or no such run. `Runs.load`
    raises ConfigError for a damaged trace.
    """
    if place.is_dir() and (place / MANIFEST).exists():
        return _experiment(place, seed, variant)
    file = place / DEMO_TRACE if place.is_dir() else place
    if not file.exists() or file.suffix == ".mcap":
        raise ConfigError(
            f"{place}: there are no recorded runs; expected the folder of an experiment"
            " or a demo, or a trace (.npz); recordings of robots: swarmctl view --web FILE"
        )
    if seed is not None or variant is not None:
        raise ConfigError(f"{place}: one trace; --seed and --variant are for experiments")
    return Runs(str(place), [file.name], lambda _: RecordedRun(load_trace(file)), file.name)


def _experiment(folder: Path, seed: int | None, variant: str | None) -> Runs:
    """The runs with a trace of the experiment in `folder`; the first has this seed and variant."""
    results = load_results(folder)
    kept = [run for run in results.runs if trace_path(folder, run).exists()]
    if not kept:
        why = "no run has finished" if not results.runs else "they were run with --no-traces"
        raise ConfigError(f"{folder}: there are no traces ({why}); run the experiment with them")
    chosen = kept
    if variant is not None:
        chosen = [run for run in chosen if run.variant.name == variant]
        if not chosen:
            names = [name for name in results.variants if name]
            raise ConfigError(f"--variant: {unknown('variant', variant, names)}")
    if seed is not None:
        seeds = [str(run.seed) for run in chosen]
        chosen = [run for run in chosen if run.seed == seed]
        if not chosen:
            raise ConfigError(f"--seed: {unknown('seed', str(seed), seeds)}")
    runs = {run.title: run for run in kept}

    def load(name: str) -> RecordedRun:
        run = runs[name]
        effective = run.variant.effective
        fields = fields_of(Layered((str(folder), effective)), effective.get("fields", ()))
        trace = load_trace(trace_path(folder, run))
        platforms = _platforms(effective)
        return RecordedRun(trace, fields, platforms, results.report_units)

    plural = "s" if len(kept) > 1 else ""
    title = f"{results.plan.scenario}, {len(kept)} run{plural}"
    return Runs(title, list(runs), load, chosen[0].title)


def _platforms(effective: Mapping[str, Any]) -> dict[str, Platform]:
    files = effective.get("platforms", {})
    return {name: platform_of(name, Layered((name, data))) for name, data in files.items()}
