"""A recording of another machine ends in one line or is read, whatever its bytes are."""

from __future__ import annotations

import math
import random
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from msgspec import structs

from swarmd.core.errors import SwarmError
from swarmd.daemon.recording import messages
from swarmd.daemon.recording.head import head_of
from swarmd.daemon.recording.inputs import MEMORY
from swarmd.daemon.recording.merge import place, survey, write_merged
from swarmd.daemon.recording.reader import RecordedFile, read_file
from swarmd.drivers.replay import ReplayDriver
from swarmd.operator.replay.replay import memory_in, prepare, recordings_of
from swarmd.operator.replay.swarm import first_difference, place_lives, repeat_together
from swarmd.operator.view.recording_source import RecordingSource
from swarmd.robot import memory
from swarmd.settings.platforms import load_platform
from swarmd.sim.report.recording_report import trace_of
from tests.support.examples import part
from tests.support.recorded_stories import ORIGINS, Busy, repeat, rewritten

NUMBERS = (0, -1, 1, 7, 2**31, 2**62, -(2**63), math.nan, math.inf, -math.inf)
WRONG = (None, True, False, "", "x", "list", *NUMBERS)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> RecordedFile:
    """A second of a robot that has learnt, with its memory."""
    busy = Busy(tmp_path_factory.mktemp("recording"), 3, has_ring=True)
    busy.wander(8.0)
    busy.robot.ask("run", pattern="random_walk")
    busy.story.recorder.begin(busy.robot)
    busy.robot.advance(1.0)
    return busy.story.recorder.finish()


def of_another_robot(recorded: RecordedFile) -> RecordedFile:
    """The same recording, by another robot with another clock."""
    head = head_of(recorded.about, "")
    identity = structs.replace(head.identity, robot="another")
    texts = structs.replace(head, identity=identity, clock="another").texts()
    return replace(recorded, about={**recorded.about, **texts})


def changed(data: bytes, rng: random.Random) -> bytes:
    """A few bytes are others, missing, there twice, or zero; or the end is missing."""
    at, size = rng.randrange(len(data) or 1), rng.choice((1, 1, 1, 2, 4, 8, 60))
    old = data[at : at + size]
    new = rng.choice((rng.randbytes(len(old)), b"", 2 * old, bytes(len(old))))
    return data[:at] if rng.random() < 0.05 else data[:at] + new + data[at + size :]


def change_file(recorded: RecordedFile, rng: random.Random, path: Path) -> None:
    """Bytes of the file, most of which have a checksum."""
    path.write_bytes(changed(recorded.path.read_bytes(), rng))


def change_texts(recorded: RecordedFile, rng: random.Random, path: Path) -> None:
    """A text on the robot."""
    about = dict(recorded.about)
    name = rng.choice(list(about))
    about[name] = changed(about[name].encode(), rng).decode(errors="replace")
    rewritten(replace(recorded, about=about), path)


def change_messages(recorded: RecordedFile, rng: random.Random, path: Path) -> None:
    """Bytes of messages, their topic, type or time."""
    some = list(recorded.messages)
    for _ in range(rng.choice((1, 1, 2, 8))):
        number, other = rng.randrange(len(some)), rng.choice(some)
        one = some[number]
        some[number] = rng.choice(
            (
                replace(one, payload=changed(one.payload, rng)),
                replace(one, payload=changed(one.payload, rng)),
                replace(one, kind=other.kind),
                replace(one, topic=other.topic),
                replace(one, at=rng.choice((0, 2**64 - 1, other.at))),
            )
        )
    rewritten(replace(recorded, messages=some), path)


def change_memory(recorded: RecordedFile, rng: random.Random, path: Path) -> None:
    """Nodes of the memory, their parts and kinds, in bytes that can be decoded."""
    (one,) = (one for one in recorded.messages if one.topic == MEMORY)
    content = msgspec.msgpack.decode(zlib.decompress(memory_in(one)), type=memory._Memory)
    for _ in range(rng.choice((1, 1, 2, 8))):
        change_node(content, rng)
    data = zlib.compress(msgspec.msgpack.encode(content))
    new = replace(one, payload=messages.bytes_message(data, 0.0).payload)
    some = [new if other is one else other for other in recorded.messages]
    rewritten(replace(recorded, messages=some), path)


def change_node(content: memory._Memory, rng: random.Random) -> None:
    compiled = {number for number, kind in enumerate(content.kinds) if kind.checksum}
    kernels = [node for node in content.nodes if node.kind in compiled]
    node = rng.choice(rng.choice((kernels, content.nodes)) or content.nodes)
    number = rng.randrange(len(content.nodes))
    match rng.randrange(8):
        case 0:
            node.kind = rng.randrange(len(content.kinds) + 1)
        case 1:
            node.parts.insert(rng.randrange(len(node.parts) + 1), rng.choice(WRONG))
        case 2:
            content.nodes[number] = node
        case 3:
            content.numbers = changed(content.numbers, rng)
        case _ if node.parts:
            at = rng.randrange(len(node.parts))
            node.parts[at] = rng.choice((*WRONG, (number,), (number,), (number,)))


def is_replayed(path: Path) -> None:
    repeat([read_file(path)], ORIGINS)


def is_replayed_in_a_swarm(path: Path) -> None:
    """Its clock is the timeline of another robot's recording."""
    paths = [path, path.with_name("other.mcap")]
    recordings = recordings_of(map(read_file, paths))
    lives = [prepare(files, ORIGINS) for files in recordings]
    place_lives(lives, paths)
    repeat_together(lives)
    first_difference(lives)
    for life in lives:
        life.parity()


def is_merged(path: Path) -> None:
    found = survey([path])
    if found.sources:
        write_merged(place(found), path.with_name("merged.mcap"))


def is_shown(path: Path) -> None:
    source = RecordingSource([path])
    trace_of(source.timeline, path)
    for robot in source.robots:
        source.frame(), source.rows(), source.marks()
        source.scan(robot.name), source.detail(robot.name)


def is_played(path: Path) -> None:
    platform = load_platform("waffle_pi")
    ReplayDriver(swarm="s", robot="r", platform=platform, options={"file": str(path)})


Change = Callable[[RecordedFile, random.Random, Path], None]
Reader = Callable[[Path], None]


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("seed", part(range(1), range(1, 50)))
@pytest.mark.parametrize("change", [change_file, change_texts, change_messages, change_memory])
def test_changed_recordings_end_in_one_line_or_are_read(
    recording: RecordedFile, tmp_path: Path, change: Change, seed: int
) -> None:
    rng, path = random.Random(seed), tmp_path / "changed.mcap"
    readers: list[Reader] = [is_replayed, is_replayed_in_a_swarm]
    rewritten(of_another_robot(recording), tmp_path / "other.mcap")
    if change is not change_memory:  # which others leave out
        readers += [is_merged, is_shown, is_played]
    lines = []
    for _ in range(25):
        change(recording, rng, path)
        for reader in readers:
            try:
                reader(path)
            except SwarmError as error:
                lines.append(str(error))
    assert "\n" not in "".join(lines)
