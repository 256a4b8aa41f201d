"""Merges the recordings of several robots into one file with one timeline."""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from swarmd.core.bounds import MAX_SECONDS
from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.files import whole_file
from swarmd.daemon.recording.clock_offset import Alignment, Exchange, align
from swarmd.daemon.recording.fetch import CLOCKS_FILE, read_exchanges
from swarmd.daemon.recording.inputs import INPUT, MEMORY
from swarmd.daemon.recording.messages import is_known, message_on
from swarmd.daemon.recording.reader import RecordedFile, RecordedMessage, clock_of, read_file
from swarmd.daemon.recording.writer import METADATA, PROFILE, Channels

CLOCK_TOPIC = "/clock/pair"
MAX_TIME = 2**64 - 1  # ns in a file


@dataclass(slots=True)
class Source:
    """The files that a robot recorded on one clock (until a reboot); times in s on this clock."""

    robot: str
    clock: str
    about: Mapping[str, str]  # texts on the robot, from the first file
    files: list[tuple[float, Path]] = field(default_factory=list)  # by their earliest time
    begin: float = float("inf")  # the earliest time of all files
    end: float = float("-inf")  # the latest time of all files


@dataclass(slots=True)
class Recordings:
    """The result of `survey`: sources, exchanges of all clocks, and faults of files."""

    sources: list[Source]
    exchanges: list[Exchange]
    faults: list[str]


@dataclass(frozen=True, slots=True)
class Placed:
    """A source on the timeline; `alignment` None: placed by the robot's own wall clock."""

    source: Source
    alignment: Alignment | None

    def row(self, names: Mapping[str, str]) -> dict[str, Any]:
        """The estimate as JSON, in s and ppm; `names` of robots by clock."""
        alignment = self.alignment
        return {
            "robot": self.source.robot,
            "clock": self.source.clock,
            "is_aligned": alignment is not None,
            "offset": None if alignment is None else alignment.offset,
            "drift_ppm": None if alignment is None else 1e6 * alignment.drift,
            "error": None if alignment is None else alignment.error,
            "via": []
            if alignment is None
            else [names.get(clock, clock) for clock in alignment.via],
            "begin": self.source.begin,
            "end": self.source.end,
        }


def survey(paths: Sequence[Path]) -> Recordings:
    """Read recordings of robots once: time spans, files by clock, and exchanges between clocks.

    Returns also the faults of files, such as a truncated end; the whole messages of a faulty file
    are used. ConfigError if a file is no recording of a robot.
    """
    sources: dict[tuple[str, str], Source] = {}  # by robot and clock
    exchanges: list[Exchange] = []
    faults = []
    for path in paths:
        recording = read_file(path)
        if recording.fault:
            faults.append(f"{path}: {recording.fault}; what is whole is merged")
        recorded_messages, foreign_fault = _known_messages(recording)
        if foreign_fault:
            faults.append(f"{path}: {foreign_fault}")
        if not recorded_messages:
            continue
        source = _source(recording, sources)
        try:
            times = [clock_of(recording.about, message.at) for message in recorded_messages]
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from error
        source.files.append((min(times), path))
        source.begin = min(source.begin, *times)
        source.end = max(source.end, *times)
        exchanges += _exchanges(recording, source.clock)
    # `record fetch` puts the files into a folder of their robot, and the exchanges with the
    # operator's clock into the folder above. The user may have moved files.
    folders = {folder for path in paths for folder in (path.parent, path.parent.parent)}
    for folder in sorted(folders):
        exchanges += read_exchanges(folder / CLOCKS_FILE)
    for source in sources.values():
        source.files.sort()
    # A stranger's recording may state times that no clock shows.
    possible = [
        one
        for one in exchanges
        if all(0.0 <= time <= MAX_SECONDS for time in (one.sent, one.answered, one.returned))
    ]
    return Recordings(list(sources.values()), possible, faults)


def _known_messages(recording: RecordedFile) -> tuple[list[RecordedMessage], str]:
    """The messages of types that a recording has, and a text about all others; empty without."""
    known = [message for message in recording.messages if is_known(message.kind)]
    kind_of_topic = {
        message.topic: message.kind for message in recording.messages if not is_known(message.kind)
    }
    if not kind_of_topic:
        return known, ""
    topic, kind = next(iter(kind_of_topic.items()))
    others = " and others" if len(kind_of_topic) > 1 else ""
    text = f"{len(kind_of_topic)} topics of types that recordings do not have are left out:"
    return known, f"{text} {topic[:80]!r} ({kind[:80]!r}){others}"


def place(recordings: Recordings, reference: str | None = None) -> list[Placed]:
    """Align the clock of each source with the clock of the robot `reference`.

    A source is a robot's files on one clock. `reference`: None for the robot of the first source.
    The first source of this robot comes first in the result. ConfigError if no recording is of this
    robot.
    """
    sources = recordings.sources
    names = [source.robot for source in sources]
    if reference is not None and reference not in names:
        raise ConfigError(
            f"no recording of robot {reference!r}; there are {', '.join(sorted(set(names)))}"
        )
    first = sources[0 if reference is None else names.index(reference)]
    spans: dict[str, tuple[float, float]] = {}
    for source in sources:
        begin, end = spans.get(source.clock, (source.begin, source.end))
        spans[source.clock] = min(begin, source.begin), max(end, source.end)
    alignments = align(recordings.exchanges, spans, first.clock)
    ordered = [first, *(source for source in sources if source is not first)]
    return [Placed(source, alignments.get(source.clock)) for source in ordered]


def write_merged(placed: Sequence[Placed], path: Path) -> int:
    """Write all messages to `path` in the order of the timeline; returns their number.

    The timeline is the wall clock of the first source. A topic `/scan` of tb3-01 becomes
    `/tb3-01/scan`. OSError if the disk fails; the incomplete file is then removed.
    """
    reference = placed[0].source.about
    streams = [messages_of(source, reference) for source in placed]
    with whole_file(path) as partial, partial.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(PROFILE, "swarmd")
        writer.add_metadata(METADATA, _about(placed))
        for source in (placed_source.source for placed_source in placed):
            writer.add_metadata(f"{METADATA}/{source.robot}", dict(source.about))
        count = _write(writer, heapq.merge(*streams, key=lambda timed: timed[0]))
        writer.finish()  # type: ignore[no-untyped-call]
    return count


Timed = tuple[int, str, str, int, bytes]
"""Time in ns since 1970, topic, type, sequence and bytes of a message."""


def _write(writer: Writer, messages: Iterable[Timed]) -> int:
    channels = Channels(writer)
    count = 0
    for at, topic, kind, sequence, payload in messages:
        writer.add_message(channels.id_of(topic, kind), at, payload, at, sequence)
        count += 1
    return count


def messages_of(placed: Placed, reference: Mapping[str, str]) -> Iterator[Timed]:
    """Yields the messages of a source in order, with the robot's name in their topics.

    Their times are converted to the clock of the reference robot, whose texts are `reference`. The
    inputs for a replay are left out, since a merged file cannot be replayed. Only one file at a
    time is in memory.
    """
    robot = placed.source.robot
    for _, path in placed.source.files:
        recording = read_file(path)
        known = (message for message in recording.messages if is_known(message.kind))
        kept = (message for message in known if message.topic not in (INPUT, MEMORY))
        for message in sorted(kept, key=lambda message: message.at):
            at = time_on(reference, placed.alignment, recording.about, message.at)
            yield at, f"/{robot}{message.topic}", message.kind, message.sequence, message.payload


def time_on(
    reference: Mapping[str, str], alignment: Alignment | None, about: Mapping[str, str], at: int
) -> int:
    """A time of a recording on the wall clock of the robot `reference`, both in ns since 1970.

    `about`: the texts of the recording. `alignment`: of its clock; None leaves the time as it is.
    """
    if alignment is not None:
        time = alignment.to_reference(clock_of(about, at))
        at = int(reference["wall_ns"]) - int(reference["boot_ns"]) + round(1e9 * time)
    return min(max(at, 0), MAX_TIME)


def rows(placed: Sequence[Placed]) -> list[dict[str, Any]]:
    """The table of clock estimates, for display and for the merged file."""
    names = {source.source.clock: source.source.robot for source in placed}
    return [source.row(names) for source in placed]


def _about(placed: Sequence[Placed]) -> dict[str, str]:
    return {
        "kind": "merged",
        "reference": placed[0].source.robot,
        "robots": ",".join(dict.fromkeys(source.source.robot for source in placed)),
        "clocks": json.dumps(rows(placed)),
    }


def _source(recording: RecordedFile, sources: dict[tuple[str, str], Source]) -> Source:
    about = recording.about
    if about.get("kind") == "merged":
        raise ConfigError(f"{recording.path}: merged already; give the robots' own recordings")
    missing = {"robot", "clock", "wall_ns", "boot_ns"} - about.keys()
    if missing:
        raise ConfigError(
            f"{recording.path}: it does not tell {', '.join(sorted(missing))} of its robot;"
            " expected a recording by swarmd"
        )
    key = about["robot"], about["clock"]
    return sources.setdefault(key, Source(*key, about))


def _exchanges(recording: RecordedFile, clock: str) -> Iterator[Exchange]:
    for message in recording.messages:
        if message.topic == CLOCK_TOPIC:
            with suppress(CodecError):
                pair = message_on(message.topic, message.kind, message.payload)
                yield Exchange(clock, pair.peer_clock, pair.sent, pair.answered, pair.returned)
