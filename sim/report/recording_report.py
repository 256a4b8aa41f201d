"""The report of a recording as HTML: numbers and stops of each robot, figures, and a player."""

from __future__ import annotations

import itertools
import json
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError
from swarmd.core.incident import Incident
from swarmd.core.values import Array
from swarmd.daemon.recording.messages import twist_of
from swarmd.operator.texts.values import clock_cells
from swarmd.operator.view.recording_source import RecordingSource
from swarmd.operator.view.timeline import APART, Timeline, Track
from swarmd.sim.film.colours import STATES, UNKNOWN
from swarmd.sim.plots.scene import robot_colour, robot_style
from swarmd.sim.plots.theme import new_figure, tidy
from swarmd.sim.plots.trajectories import MAX_NAMED, trajectories_figure
from swarmd.sim.report.figures import drawn, figures_html
from swarmd.sim.report.html import page, player_section
from swarmd.sim.report.player import player_of
from swarmd.sim.report.tables import table
from swarmd.sim.trace import NAMED, Trace, blank_decisions, enter_named

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_STOP = 1.0
"""Seconds from which a stop is listed."""
MOVING = 0.005  # m/s and rad/s above which a command moves a robot
MAX_STOPS = 40
MAX_EVENTS = 60
BEFORE = 10.0
"""Seconds before an incident at which the player begins."""
PERIOD = 0.1  # s between two instants of the trace
MAX_INSTANTS = 20_000


def recording_report(paths: Sequence[Path], place: Path) -> str:
    """The report of recordings of robots, or of a merged file, as HTML.

    `place`: the file, or the folder of `paths`. The player begins BEFORE an incident. ConfigError
    if a file is no recording, or none has odometry.
    """
    source = RecordingSource(paths)
    timeline = source.timeline
    trace = trace_of(timeline, place)
    incident = timeline.incident(paths[0].name)
    player = player_of(source, start=max(incident[0] - BEFORE, 0.0) if incident else 0.0)
    frame_text = "Positions are in the shared frame of the robots."
    if not timeline.is_shared:
        frame_text = (
            "Positions are by odometry, which drifts. The start poses are not known:"
            f" robots are drawn {APART:g} m apart, and distances between them mean nothing."
        )
    stops = stops_of(trace)
    figures = [
        drawn(_states_figure(trace), "States over time."),
        drawn(_gaps_figure(trace), "Gap from the footprint to the nearest return over time."),
        *(
            drawn(_lines_figure(trace, values, name), f"Reading {name} over time.")
            for name, values in trace.readings.items()
        ),
        drawn(
            trajectories_figure(trace, "paths"), "Paths: hollow at the start, filled at the end."
        ),
    ]
    robots = [
        ("robots", "Robots", f"{_notes(timeline)}<p>{frame_text}</p>{_robots(trace, timeline)}"),
    ]
    drawings = [("figures", "Figures", figures_html(figures))]
    played = player_section("The whole recording", player.period)
    listed = [
        ("stops", "Stops", _listed(stops, ("TIME", "ROBOT", "FOR", "REASON"), MAX_STOPS)),
    ]
    events = [
        ("events", "Events", _listed(_events(timeline), ("TIME", "ROBOT", "EVENT"), MAX_EVENTS)),
    ]
    last = [
        ("clocks", "Clocks", _clocks(timeline.about)),
        (
            "again",
            "How to make it again",
            f"<pre>swarmctl exp report {shlex.quote(str(place))}</pre>",
        ),
        ("manifest", "Made with", _made_with(timeline)),
    ]
    count = len(trace.ids)
    of = f"ecording of {count} robot{'s' if count > 1 else ''}, {trace.duration:.0f} s"
    if incident is None:
        return page(
            title=place.stem,
            question=f"R{of}",
            summary=place.name,
            sections=[
                *robots,
                *drawings,
                *listed,
                ("run", "The run", played),
                *events,
                *last,
            ],
            player=player,
        )
    # Who reads of an incident asks for its cause, then looks at it.
    at, what = incident
    first = [
        ("run", "The run", f"<p>{frame_text}</p>{played}"),
        ("kept", "Who kept it", _kept(timeline, at, what, place)),
    ]
    return page(
        title=what.text if what.text.startswith(what.robot) else f"{what.robot}: {what.text}",
        question=(
            f"Incident {what.id} ({what.kind}) of {what.robot} at {at:.1f} s, told by {what.by};"
            f" r{of}"
        ),
        summary=place.name,
        sections=[*first, *robots, *listed, *events, *drawings, *last],
        player=player,
    )


def trace_of(timeline: Timeline, path: Path) -> Trace:
    """A trace of the robots of a recording that have odometry, for figures and tables.

    The trace has an instant each PERIOD s, at most MAX_INSTANTS. It has no contacts. A safe command
    that was not recorded is zero; any other value is NaN, False or empty. `path`: the file, for
    ConfigError if no robot has recorded odometry.
    """
    tracks = {
        name: track for name, track in timeline.tracks.items() if track.topics["odometry"].times
    }
    if not tracks:
        raise ConfigError(f"{path}: no odometry was recorded, so there are no positions")
    duration = timeline.duration
    t = np.linspace(0.0, duration, max(2, min(int(duration / PERIOD) + 1, MAX_INSTANTS)))
    shape = len(t), len(tracks)
    arrays: dict[str, Any] = blank_decisions(shape)
    arrays |= {name: np.full((*shape, 3), np.nan) for name in ("pose", "requested")}
    arrays["safe"] = np.zeros((*shape, 3))
    # Values of statuses, by kind (a report, a reading or a reported text) and by key.
    named: dict[str, dict[str, NDArray[Any]]] = {kind: {} for kind in NAMED}
    for robot, (name, track) in enumerate(tracks.items()):
        for instant, now in enumerate(t.tolist()):
            pose = timeline.pose(name, now)
            decision = track.decision(now)
            if pose is not None:
                arrays["pose"][instant, robot] = pose
            if decision is not None:
                _enter(arrays, (instant, robot), decision)
        yaws = arrays["pose"][:, robot, 2]
        # Known yaws are continuous, without jumps by a turn.
        yaws[np.isfinite(yaws)] = np.unwrap(yaws[np.isfinite(yaws)])
        _enter_statuses(named, track, t, robot, shape)
    arrays |= {kind: dict(sorted(values.items())) for kind, values in named.items()}
    platforms = [track.platform for track in tracks.values()]
    return Trace(
        ids=tuple(tracks),
        t=t,
        contact_t=np.zeros(0),
        contact_pair=np.zeros((0, 2), dtype=np.int64),
        contact_speed=np.zeros((0, 2)),
        platforms=tuple(platform.name for platform in platforms),
        footprints={platform.name: platform.footprint for platform in platforms},
        meta={"recording": True},
        **arrays,
    )


def _enter(arrays: Mapping[str, Any], place: tuple[int, int], decision: Any) -> None:
    """Write a recorded decision at `place`, an instant and a robot, of the arrays."""
    for name in ("state", "reason", "gap", "scan_age"):
        arrays[name][place] = getattr(decision, name)
    for name in ("active", "recovering"):
        arrays[name][place] = getattr(decision, f"is_{name}")
    for name in ("safe", "requested"):
        twist = twist_of(getattr(decision, name))
        arrays[name][place] = twist.linear, twist.angular, twist.lateral


def _enter_statuses(
    named: Mapping[str, dict[str, NDArray[Any]]],
    track: Track,
    t: Array,
    robot: int,
    shape: tuple[int, int],
) -> None:
    """Write the reports and readings of a robot's statuses into `named`.

    `robot`: the index of the robot. `t`: the instants in s. `shape`: (instants, robots). Values are
    blank while nothing is recorded.
    """
    for at in track.topics["status"].times:
        status = track.status(at)
        if status is not None:
            since = slice(int(np.searchsorted(t, at)), None)  # until a later status overwrites it
            enter_named(named, (since, robot), shape, status)
    is_silent = np.array([not track.is_heard(now) for now in t.tolist()])
    for kind, blank in NAMED.items():
        for values in named[kind].values():
            values[is_silent, robot] = blank


def _robots(trace: Trace, timeline: Timeline) -> str:
    """An HTML table with a row for each robot: distance, times, protection, gap and losses.

    A robot moves while it runs and its safe command is above MOVING. A loss is noted in a recording
    if the recorder dropped entries, since the disk was slow.
    """
    rows = []
    assert trace.state is not None
    assert trace.active is not None
    assert trace.gap is not None
    period = trace.duration / max(len(trace.t) - 1, 1)  # s between two instants
    for index, name in enumerate(trace.ids):
        is_running = trace.state[:, index] == "running"
        is_moving = is_running & (np.abs(trace.safe[:, index]) > MOVING).any(axis=1)
        steps = np.diff(trace.pose[:, index, :2], axis=0)  # m, NaN without a pose
        gaps = trace.gap[:, index]
        is_active = trace.active[is_running, index]  # of protection
        cells = (
            name,
            f"{float(np.nansum(np.hypot(steps[:, 0], steps[:, 1]))):.2f} m",
            f"{period * float(is_running.sum()):.1f} s",
            f"{period * float(is_moving.sum()):.1f} s",
            f"{100.0 * float(is_active.mean()):.0f} %" if is_active.size else "-",
            f"{float(np.nanmin(gaps)):.2f} m" if np.isfinite(gaps).any() else "-",
            str(timeline.tracks[name].dropped or "-"),
        )
        rows.append(tuple(map(escape, cells)))
    head = ("ROBOT", "DISTANCE", "RUNNING", "MOVING", "PROTECTION", "SMALLEST GAP", "LOSSES NOTED")
    note = (
        '<p class="dim">Protection: share of the time in state running in which it reduced or'
        " replaced the command. Gap: to the nearest return of a scan. Losses noted: how often the"
        " recorder dropped entries, since the disk was slow.</p>"
    )
    return table(head, rows, "robots") + note


def stops_of(trace: Trace) -> list[tuple[str, ...]]:
    """The stops of at least LEAST_STOP s in order of time: time, robot, duration and reason.

    A robot stops if its state is estopped or faulted, or if it is running and the safe command is
    zero although its pattern requests motion.
    """
    assert trace.state is not None
    assert trace.reason is not None
    assert trace.requested is not None
    stops: list[tuple[float, tuple[str, ...]]] = []
    for robot, name in enumerate(trace.ids):
        state = trace.state[:, robot]
        reason = trace.reason[:, robot]
        is_requested = (np.abs(np.nan_to_num(trace.requested[:, robot])) > MOVING).any(axis=1)
        is_zero = (np.abs(trace.safe[:, robot]) <= MOVING).all(axis=1)
        is_held = (state == "running") & is_requested & is_zero
        is_stopped = is_held | np.isin(state, ("estopped", "faulted"))
        for first, end in _spans(is_stopped):
            start = float(trace.t[first])
            seconds = float(trace.t[end - 1] - trace.t[first])
            if is_stopped[first] and seconds >= LEAST_STOP:
                why = _most_frequent(reason[first:end]) or str(state[first])
                stops.append((start, (f"{start:.1f} s", name, f"{seconds:.1f} s", why)))
    return [cells for _, cells in sorted(stops)]


def _spans(values: NDArray[Any]) -> Iterator[tuple[int, int]]:
    """The spans of equal values (instants,): first instant, first instant after."""
    changes = np.flatnonzero(values[1:] != values[:-1]) + 1
    return itertools.pairwise([0, *changes.tolist(), len(values)])


def _most_frequent(reasons: Iterable[str]) -> str:
    """The most frequent of the reasons in words, the earliest of equals; empty without a reason."""
    given = [str(reason) for reason in reasons if reason]
    return max(dict.fromkeys(given), key=given.count, default="").replace("_", " ")


def _events(timeline: Timeline) -> list[tuple[str, ...]]:
    events = [
        (at, name, text)
        for name, track in timeline.tracks.items()
        for at, text in track.events(timeline.duration)
        if at >= 0.0
    ]
    return [(f"{at:.1f} s", name, text) for at, name, text in sorted(events)]


def _listed(rows: list[tuple[str, ...]], head: tuple[str, ...], most: int) -> str:
    if not rows:
        return ""
    note = f"<p>The first {most} of {len(rows)}.</p>" if len(rows) > most else ""
    return note + table(head, [tuple(map(escape, row)) for row in rows[:most]], "listed")


def _states_figure(trace: Trace) -> Figure:
    """A bar for each robot, coloured by state."""
    from matplotlib.patches import Patch

    assert trace.state is not None
    figure = new_figure(7.5, 1.2 + 0.3 * len(trace.ids))
    axes = figure.add_subplot()
    tidy(axes)
    for row in range(len(trace.ids)):
        for first, end in _spans(trace.state[:, row]):
            if state := str(trace.state[first, row]):
                start = trace.t[first]
                stop = trace.t[min(end, len(trace.t) - 1)]
                axes.barh(row, stop - start, left=start, color=STATES.get(state, UNKNOWN))
    axes.set_yticks(range(len(trace.ids)), trace.ids)
    axes.invert_yaxis()
    axes.set_xlabel("time [s]")
    shown = [state for state in STATES if (trace.state == state).any()]
    handles = [Patch(color=STATES[state], label=state) for state in shown]
    if handles:
        figure.legend(
            handles=handles, loc="outside upper right", ncols=5, frameon=False, fontsize=9
        )
    return figure


def _gaps_figure(trace: Trace) -> Figure:
    assert trace.gap is not None
    figure = _lines_figure(trace, trace.gap, "gap [m]")
    figure.axes[0].set_ylim(bottom=0.0)
    return figure


def _lines_figure(trace: Trace, values: Array, label: str) -> Figure:
    """A line for each robot: values (T, n) over time."""
    figure = new_figure(7.5, 4.2)
    axes = figure.add_subplot()
    tidy(axes)
    for row, name in enumerate(trace.ids[:MAX_NAMED]):
        axes.plot(trace.t, values[:, row], color=robot_colour(row), linestyle=robot_style(row),
                  linewidth=1.0, label=name)  # fmt: skip
    axes.set_xlabel("time [s]")
    axes.set_ylabel(label)
    figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


def _notes(timeline: Timeline) -> str:
    notes = "; ".join(map(escape, timeline.notes))
    return f"<p><b>The file is not whole</b>: {notes}.</p>" if notes else ""


def _kept(timeline: Timeline, at: float, incident: Incident, place: Path) -> str:
    """An HTML table of the robots that had an incident at `at` s, told it, or kept their minute.

    Several robots have an emergency stop or a mark: each says so in its own recording.
    """
    had = {incident.robot}
    for name, track in timeline.tracks.items():
        own = (one for _, one in track.incidents() if one.id == incident.id)
        had |= {one.robot for one in own if one.robot == name}
    rows = []
    for name in sorted(had | timeline.tracks.keys(), key=lambda name: (name not in had, name)):
        what = "had it" if name in had else "told it" if name == incident.by else "kept it"
        span = "no recording of it is here"
        if name in timeline.tracks:
            track = timeline.tracks[name]
            span = f"{track.begin - at:+.1f} to {track.end - at:+.1f} s"
        rows.append(tuple(map(escape, (name, what, span))))
    missing = sorted(had - timeline.tracks.keys())
    notes = [
        f'<p class="dim">What the others last knew of {escape(name)}, and when its minute comes:'
        f" <code>swarmctl replay {escape(shlex.quote(str(place)))} --why"
        f" {escape(shlex.quote(name))}</code></p>"
        for name in missing
    ]
    return table(("ROBOT", "", "RECORDED, TO THE INCIDENT"), rows, "listed") + "".join(notes)


def _clocks(about: Mapping[str, str]) -> str:
    """The estimates of `record merge`; empty for one robot."""
    if "clocks" not in about:
        return ""
    try:
        rows = [(one["robot"], *clock_cells(one)) for one in json.loads(about["clocks"])]
    except (ValueError, LookupError, TypeError, RecursionError):
        return "<p><b>The clocks of the recording cannot be read.</b></p>"
    head = ("ROBOT", "OFFSET", "DRIFT", "ERROR AT MOST", "VIA")
    return table(head, [tuple(map(escape, row)) for row in rows], "clocks")


def _made_with(timeline: Timeline) -> str:
    keys = ("platform", "driver", "version", "clock", "swarm")
    rows = [
        (name, *(track.about.get(key, "-") for key in keys))
        for name, track in timeline.tracks.items()
    ]
    head = ("ROBOT", *(key.upper() for key in keys))
    return table(head, [tuple(map(escape, row)) for row in rows], "manifest")
