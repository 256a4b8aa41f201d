"""Files of incidents: read again and replayed; hostile and damaged bytes are named."""

from __future__ import annotations

import os
import random
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from swarmd.core.errors import CodecError
from swarmd.core.events import ScanInput
from swarmd.core.values import Scan
from swarmd.daemon.recording import frames
from swarmd.daemon.recording.incident_file import IncidentHead, pack, read, read_head, to_recording
from swarmd.daemon.recording.reader import RecordedFile, read_file
from swarmd.daemon.recording.ring import MAX_FILE, Left, Ring, entries_of, read_left
from tests.support.examples import examples
from tests.support.incidents import ID, WALL, incident_of, keep
from tests.support.recorded_stories import ORIGINS, Story, repeat

SIZE = struct.Struct("<I")


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kept")
    story = Story(folder)
    story.robot.advance(1.0)
    story.robot.ask("run", pattern="drive", params={"speed": 0.1})
    story.robot.advance(0.5)
    story.recorder.begin(story.robot)
    story.robot.advance(3.0)
    story.recorder.finish()
    return keep(story, folder / "tb3-01")


def head_of_frames(data: bytes) -> IncidentHead:
    return IncidentHead(
        incident=incident_of("a"), at=1.0, clock="c", begin=1.0, end=1.0, size=len(data),
        about={"robot": "a"}, boot=1.0, wall=WALL,
    )  # fmt: skip


def frames_of(*entries: frames.Entry) -> bytes:
    frame = frames.batch([frames.encode(one) for one in entries])
    return SIZE.pack(len(frame)) + frame


def test_a_file_becomes_a_recording_that_is_repeated_to_the_bit(kept: Path) -> None:
    path = to_recording(kept)
    assert path.name == f"{ID}-00001.mcap"
    assert to_recording(kept) == path, "the same recording again, not another one beside it"
    parity = repeat([read_file(path)], ORIGINS)[1]
    assert parity.safe.count > 60
    assert parity.safe.is_equal
    assert sum(one.topic == "/incident" for one in read_file(path).messages) == 1


def test_the_recording_of_a_robot_that_was_killed_names_its_incident(tmp_path: Path) -> None:
    data = frames_of(frames.EventEntry(1.0, "the last one"))  # the next daemon found the incident
    path = tmp_path / f"{ID}.incident"
    path.write_bytes(pack(head_of_frames(data), data))
    named = [one for one in read_file(to_recording(path)).messages if one.topic == "/incident"]
    assert len(named) == 1


def test_a_cut_file_is_damaged_wherever_it_is_cut(kept: Path, tmp_path: Path) -> None:
    data = kept.read_bytes()
    for length in (0, 1, 3, 4, 5, 100, len(data) // 2, len(data) - 5, len(data) - 1):
        path = tmp_path / "cut.incident"
        path.write_bytes(data[:length])
        with pytest.raises(CodecError):
            read(path)


def test_flipped_bytes_give_a_recording_or_an_error_of_the_file(kept: Path, tmp_path: Path) -> None:
    data, draw, errors = kept.read_bytes(), random.Random(3), 0
    (size,) = SIZE.unpack_from(data)
    body = range(SIZE.size + size, len(data))
    for place in [*draw.sample(range(SIZE.size + size), 60), *draw.sample(body, 20)]:
        path = tmp_path / "flipped.incident"
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        try:
            entries_of(read(path)[1])
        except CodecError:
            errors += 1
        else:
            assert place not in body, "a checksum covers the frames"
    assert errors >= 20


@pytest.mark.parametrize(
    "content", [b"", b"\x89MCAP0\r\n\x1a\n" * 9, b"\xff" * 99, random.Random(2).randbytes(64)]
)
def test_a_foreign_file_is_none(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.incident"
    path.write_bytes(content)
    with pytest.raises(CodecError):
        read_head(content)
    with pytest.raises(CodecError):
        read(path)


def test_a_file_that_unpacks_to_more_than_it_states_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.incident"
    packed = pack(head_of_frames(bytes(100)), b"")
    (size,) = SIZE.unpack_from(packed)
    path.write_bytes(packed[: SIZE.size + size] + zlib.compress(bytes(1 << 25), 9))
    tracemalloc.start()
    with pytest.raises(CodecError):
        read(path)
    assert tracemalloc.get_traced_memory()[1] < 1 << 22
    tracemalloc.stop()
    huge = structs.replace(head_of_frames(b""), size=MAX_FILE + 1)
    with pytest.raises(CodecError):
        read_head(pack(huge, b""))


SCAN = Scan(1, 1.0, np.ones(5), np.zeros(1), 0.1, 3.0)


@pytest.mark.parametrize(
    "entry",
    [
        frames.EventEntry(float("nan"), ""),
        frames.EventEntry(float("inf"), ""),
        frames.EventEntry(-1e300, ""),
        frames.EventEntry(1e18, ""),
        frames.TextEntry(1.0, "/status", b"\xff\xff"),
        frames.input_entry(ScanInput(SCAN), 1.0),
    ],
)
def test_an_entry_that_no_robot_writes_is_an_error_of_the_file(
    tmp_path: Path, entry: frames.Entry
) -> None:
    path = tmp_path / "a.incident"
    for data in (frames_of(entry), frames_of(frames.EventEntry(1.0, "first"), entry)):
        path.write_bytes(pack(head_of_frames(data), data))
        with pytest.raises(CodecError):
            to_recording(path)
        assert [one.name for one in tmp_path.iterdir()] == [path.name], "no part of a recording"


def nested(depth: int) -> bytes:
    frame = b"\x91\x94\xa4sent\xcb" + struct.pack(">d", 1.0) + b"\xa1a" + b"\x91" * depth + b"\xc0"
    return SIZE.pack(len(frame)) + frame


@pytest.mark.parametrize(
    "more",
    [b"\x01", SIZE.pack(2**32 - 1) + b"\x90", SIZE.pack(4) + b"\xdd\xff\xff\xff", nested(10**5)],
)
def test_frames_count_up_to_the_first_damaged_one(more: bytes) -> None:
    whole = frames_of(frames.EventEntry(1.0, "whole"))
    left = Left({}, whole + more + whole, 1.0, WALL, 0)
    assert entries_of(left) == [frames.EventEntry(1.0, "whole")]


def ring_bytes(path: Path) -> bytes:
    ring = Ring(path, {"robot": "a"}, capacity=4096, seconds=60.0, boot=1.0, wall=WALL)
    ring.begin_segment(1.0)
    for number in range(200):
        ring.write(frames.batch([frames.encode(frames.EventEntry(1.0 + number, "x" * 20))]))
        if number % 20 == 19:
            ring.begin_segment(1.0 + number)
    data = path.read_bytes()
    ring.close()
    path.write_bytes(data)  # as a process leaves it that was killed
    return data


def put(form: str, at: int, value: object) -> Callable[[bytes], bytes]:
    packed = struct.pack(form, value)
    return lambda data: data[:at] + packed + data[at + len(packed) :]


@pytest.mark.parametrize(
    "change",
    [
        lambda data: b"",
        lambda data: data[:40],
        lambda data: data[:3000],
        lambda data: b"\0" * len(data),
        put("<Q", 8, 2**63),  # tail
        put("<Q", 16, 2**64 - 1),  # head
        put("<I", 48, 2**32 - 1),  # capacity
        put("<I", 48, 0),
        put("<I", 64 + 4096, 3),  # size of the texts
    ],
)
def test_a_ring_that_is_none_is_an_error(tmp_path: Path, change: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "ring"
    path.write_bytes(change(ring_bytes(path)))
    with pytest.raises(CodecError):
        read_left(path)


def test_a_ring_with_flipped_bytes_is_read_or_an_error(tmp_path: Path) -> None:
    path = tmp_path / "ring"
    data, draw = ring_bytes(path), random.Random(1)
    whole = read_left(path)
    assert whole is not None
    assert len(entries_of(whole)) > 20
    for place in [*range(64), *draw.sample(range(64, len(data)), 100)]:
        path.write_bytes(data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :])
        try:
            left = read_left(path)
        except CodecError:
            continue
        assert left is not None
        entries_of(left)


def test_a_huge_ring_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "ring"
    ring_bytes(path)
    os.truncate(path, 1 << 40)
    tracemalloc.start()
    assert read_left(path) is not None
    assert tracemalloc.get_traced_memory()[1] < 1 << 28
    tracemalloc.stop()


def test_the_encoder_of_a_head_is_read_again() -> None:
    head = head_of_frames(b"abc")
    assert read_head(pack(head, b"abc")) == head
    with pytest.raises(CodecError):
        read_head(pack(structs.replace(head, wall=float("nan")), b""))
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(head.incident))["id"] == ID


def test_an_incident_from_before_the_boot_of_a_robot_is_read_and_converted(tmp_path: Path) -> None:
    told = frames.TextEntry(-30.0, "/incident", msgspec.json.encode(incident_of("a")))
    data = frames_of(frames.EventEntry(1.0, "first"), told)
    path = tmp_path / f"{ID}.incident"
    path.write_bytes(pack(structs.replace(head_of_frames(data), at=-30.0), data))
    assert read(path)[0].at == -30.0
    assert to_recording(path).exists()


# What a file may state


def recording_of(tmp_path: Path, *entries: frames.Entry) -> RecordedFile:
    """The recording that a file with these entries becomes; one file, with its index."""
    path = tmp_path / f"{ID}.incident"
    data = frames_of(*entries)
    path.write_bytes(pack(head_of_frames(data), data))
    made = to_recording(path)
    names = {one.name for one in tmp_path.iterdir()}
    assert names == {path.name, made.name, f"{made.stem}.index.json"}
    return read_file(made)


def test_a_memory_in_more_parts_than_a_robot_writes_is_left_out(tmp_path: Path) -> None:
    many = [frames.MemoryEntry(1.0, b"x", n, 400) for n in range(400)]
    found = recording_of(tmp_path, frames.EventEntry(1.0, ""), *many)
    assert [one.topic for one in found.messages] == ["/event", "/incident"]


def test_a_memory_that_each_part_calls_whole_is_written_once(tmp_path: Path) -> None:
    growing = [frames.MemoryEntry(1.0, bytes(100), n, n + 1) for n in range(60)]
    found = recording_of(tmp_path, *growing)
    assert [one.topic for one in found.messages].count("/memory") == 1


@pytest.mark.parametrize("step", [3.0, 90_000.0])  # s: beyond a chunk, and beyond a day
def test_entries_far_apart_become_one_file_without_a_write_to_disk_for_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: float
) -> None:
    synced: list[int] = []
    monkeypatch.setattr("os.fsync", synced.append)
    found = recording_of(tmp_path, *(frames.EventEntry(1.0 + step * n, "") for n in range(50)))
    assert len(found.messages) == 51
    assert len(synced) < 6


def test_more_entries_than_a_robot_writes_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("swarmd.daemon.recording.incident_file.MAX_ENTRIES", 50)
    recording_of(tmp_path, *(frames.EventEntry(1.0, "") for _ in range(50)))
    with pytest.raises(CodecError, match="50"):
        recording_of(tmp_path, *(frames.EventEntry(1.0, "") for _ in range(51)))
    assert not list(tmp_path.glob("*00002*"))


def test_a_file_that_unpacks_to_fifty_times_its_size_and_more_is_refused(tmp_path: Path) -> None:
    data = frames_of(*(frames.EventEntry(1.0, "x" * 900) for _ in range(4000)))
    path = tmp_path / f"{ID}.incident"
    path.write_bytes(pack(head_of_frames(data), data))
    assert len(data) > 100 * path.stat().st_size, "within what zlib gives back"
    with pytest.raises(CodecError, match=str(len(data))):
        read(path)


def test_a_head_that_states_more_bytes_than_a_robot_writes_is_refused() -> None:
    head = structs.replace(head_of_frames(b""), about={"a": "x" * (1 << 20)})
    with pytest.raises(CodecError, match="head"):
        read_head(pack(head, b""))


_at = st.floats(0.0, 1e5)
_ENTRIES = st.one_of(
    st.builds(frames.EventEntry, _at, st.text(max_size=9)),
    st.builds(
        frames.TextEntry, _at, st.sampled_from(["/status", "/incident", "/x", ""]),
        st.binary(max_size=9),
    ),
    st.builds(
        frames.MemoryEntry, _at, st.binary(max_size=9), st.integers(-9, 99), st.integers(-9, 99)
    ),
    st.builds(frames.InputEntry, _at, st.binary(max_size=30)),
    st.builds(frames.DroppedEntry, _at, st.integers(-9, 2**70)),
    st.builds(frames.SentEntry, _at, st.text(max_size=5), st.floats()),
    st.builds(
        frames.ClockEntry, _at, st.text(max_size=5), st.text(max_size=5), st.floats(), st.floats(),
        st.floats(),
    ),
)  # fmt: skip


@settings(max_examples=examples(60), deadline=None)
@given(entries=st.lists(_ENTRIES, max_size=12), noise=st.binary(max_size=9))
def test_any_entries_become_one_recording_or_an_error_of_the_file(
    tmp_path_factory: pytest.TempPathFactory, entries: list[frames.Entry], noise: bytes
) -> None:
    folder = tmp_path_factory.mktemp("any")
    path = folder / f"{ID}.incident"
    try:
        data = frames_of(*entries) + noise
    except (OverflowError, UnicodeEncodeError):
        return  # no bytes of MessagePack either
    path.write_bytes(pack(head_of_frames(data), data))
    try:
        made = to_recording(path)
    except CodecError:
        assert [one.name for one in folder.iterdir()] == [path.name]
        return
    assert len(read_file(made).messages) <= 4 * len(entries) + 1
