"""A recording of robots as a trace: positions by odometry, and what each robot decided.

Positions are those of the shared frame where all robots have one. Otherwise each robot has the
frame of its own odometry; the starts are then set side by side, since they are not known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array, Platform
from swarmd.recording.head import head_of
from swarmd.recording.messages import deserialize, odometry_of, pose_of, twist_of
from swarmd.recording.reader import RecordedFile
from swarmd.settings.platforms import load_platform
from swarmd.sim.trace import WORD, Trace, blank_decisions

PERIOD = 0.1  # s between two instants of the trace
HOLD = 0.5  # s for which the first and the last position of a robot are taken beyond its samples
MAX_INSTANTS = 20_000
APART = 1.0  # m between starts that are not known


@dataclass(slots=True)
class Track:
    """What one robot recorded: times in s of the recording, and the values at them."""

    about: Mapping[str, str]
    platform: Platform
    odometry: list[tuple[float, float, float, float]] = field(default_factory=list)
    shared: list[tuple[float, float, float, float]] = field(default_factory=list)
    frames: set[str] = field(default_factory=set)
    decided: list[float] = field(default_factory=list)
    decisions: list[Any] = field(default_factory=list)
    events: list[tuple[float, str]] = field(default_factory=list)
    dropped: int = 0


@dataclass(frozen=True, slots=True)
class Recorded:
    """A recording: its trace, `tracks` by robot, and whether positions are in a shared frame."""

    trace: Trace
    tracks: Mapping[str, Track]
    is_shared: bool


def recorded(file: RecordedFile) -> Recorded:
    """The robots of a recording; ConfigError if none of them recorded odometry."""
    tracks = _tracks(file)
    known = {name: track for name, track in tracks.items() if track.odometry}
    if not known:
        raise ConfigError(f"{file.path}: no odometry was recorded, so there are no positions")
    frames = set().union(*(track.frames for track in known.values()))
    is_shared = len(frames) == 1 and all(track.shared for track in known.values())
    ends = [row[-1][0] for row in (track.odometry for track in known.values())]
    duration = max(ends)
    count = max(2, min(int(duration / PERIOD) + 1, MAX_INSTANTS))
    t = np.linspace(0.0, duration, count)
    return Recorded(_trace(t, known, is_shared=is_shared), known, is_shared)


def _tracks(file: RecordedFile) -> dict[str, Track]:
    abouts = dict(file.robots) or {file.about.get("robot", file.path.stem): file.about}
    tracks = {
        name: Track(about, _platform(about, f"{file.path}, {name}"))
        for name, about in sorted(abouts.items())
    }
    # A recording repeats what the robot logged before; time 0 is that of the first position.
    places = [message.at for message in file.messages if message.topic.endswith("/odometry")]
    start = min(places, default=0)
    for message in file.messages:
        robot, topic = next(iter(tracks)), message.topic
        if file.robots:
            robot, _, rest = topic.removeprefix("/").partition("/")
            topic = f"/{rest}"
        if robot in tracks:
            _enter(tracks[robot], topic, message.kind, message.payload, 1e-9 * (message.at - start))
    return tracks


def _platform(about: Mapping[str, str], where: str) -> Platform:
    """The platform as the robot recorded it; of another version, the installed one of its name."""
    try:
        return head_of(about, where).platform
    except ConfigError:
        return load_platform(about.get("platform", ""))


def _enter(track: Track, topic: str, kind: str, payload: bytes, time: float) -> None:
    if topic == "/odometry":
        pose = odometry_of(deserialize(kind, payload)).pose
        track.odometry.append((time, pose.x, pose.y, pose.yaw))
    elif topic == "/pose":
        found = pose_of(deserialize(kind, payload))
        track.shared.append((time, found.pose.x, found.pose.y, found.pose.yaw))
        track.frames.add(found.frame)
    elif topic == "/decision":
        track.decided.append(time)
        track.decisions.append(deserialize(kind, payload))
    elif topic == "/event" and time >= 0.0:
        track.events.append((time, str(deserialize(kind, payload).msg)))
    elif topic == "/dropped":
        track.dropped += 1


def _trace(t: Array, tracks: Mapping[str, Track], *, is_shared: bool) -> Trace:
    shape = len(t), len(tracks)
    arrays: dict[str, Any] = {**blank_decisions(shape)}
    arrays |= {"requested": np.full((*shape, 3), np.nan), "safe": np.zeros((*shape, 3))}
    pose = np.full((*shape, 3), np.nan)
    for row, track in enumerate(tracks.values()):
        samples = np.array(track.shared if is_shared else track.odometry)
        pose[:, row] = _between(t, samples)
        if not is_shared:
            pose[:, row, 1] += APART * (row - (len(tracks) - 1) / 2.0)
        _enter_decisions(arrays, row, t, track)
    kinds = {name: track.platform for name, track in tracks.items()}
    return Trace(
        ids=tuple(tracks),
        t=t,
        pose=pose,
        contact_t=np.zeros(0),
        contact_pair=np.zeros((0, 2), dtype=np.int64),
        contact_speed=np.zeros((0, 2)),
        platforms=tuple(platform.name for platform in kinds.values()),
        footprints={platform.name: platform.footprint for platform in kinds.values()},
        meta={"recording": True},
        **arrays,
    )


def _between(t: Array, samples: Array) -> Array:
    """Poses (T, 3) at times, interpolated; NaN more than HOLD before or after all samples."""
    columns = [samples[:, 1], samples[:, 2], np.unwrap(samples[:, 3])]
    found = np.stack([np.interp(t, samples[:, 0], one) for one in columns], axis=1)
    found[(t < samples[0, 0] - HOLD) | (t > samples[-1, 0] + HOLD)] = np.nan
    return found


def _enter_decisions(arrays: Mapping[str, NDArray[Any]], row: int, t: Array, track: Track) -> None:
    """The latest decision at each instant."""
    if not track.decisions:
        return
    latest = np.searchsorted(track.decided, t, side="right") - 1
    is_known = latest >= 0
    columns: dict[str, list[Any]] = {
        "state": [one.state for one in track.decisions],
        "reason": [one.reason for one in track.decisions],
        "active": [one.is_active for one in track.decisions],
        "recovering": [one.is_recovering for one in track.decisions],
        "gap": [one.gap for one in track.decisions],
        "scan_age": [one.scan_age for one in track.decisions],
        "safe": [_plain(one.safe) for one in track.decisions],
        "requested": [_plain(one.requested) for one in track.decisions],
    }
    for name, values in columns.items():
        kind = WORD if name in ("state", "reason") else arrays[name].dtype
        arrays[name][is_known, row] = np.array(values, dtype=kind)[latest[is_known]]


def _plain(message: Any) -> tuple[float, float, float]:
    twist = twist_of(message)
    return twist.linear, twist.angular, twist.lateral
