"""What the MCAP format permits is read, or named: each writer makes other files of a recording."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import lz4.frame
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType, Writer

from swarmd.core.errors import ConfigError
from swarmd.daemon.recording.head import head_of
from swarmd.daemon.recording.merge import place, survey, write_merged
from swarmd.daemon.recording.reader import MAX_RATIO, MAX_SPARE, RecordedFile, read_file
from swarmd.drivers.replay import ReplayDriver
from swarmd.operator.view.timeline import read_timeline
from tests.support.recorded_stories import ORIGINS, Extra, Story, repeat, rewritten


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> RecordedFile:
    """Two seconds of a robot that begins to drive."""
    story = Story(tmp_path_factory.mktemp("recording"))
    story.robot.advance(1.0)
    story.recorder.begin(story.robot)
    story.run("drive", 2.0, speed=0.1)
    return story.recorder.finish()


def attachment(writer: Writer, file: IO[bytes]) -> None:
    writer.add_attachment(0, 0, "photo.jpg", "image/jpeg", bytes(1000))


def foreign_channels(writer: Writer, file: IO[bytes]) -> None:
    schema = writer.register_schema("acme/Thing", "jsonschema", b"{}")
    for topic, encoding, number in (("/thing", "json", schema), ("/raw", "", 0)):
        writer.add_message(writer.register_channel(topic, encoding, number), 1, b"{}", 1)


def other_metadata(writer: Writer, file: IO[bytes]) -> None:
    writer.add_metadata("rosbag2", {"version": "9"})


def record(code: int, body: bytes) -> bytes:
    return struct.pack("<BQ", code, len(body)) + body


def chunk(records: bytes, compression: str, packed: bytes, size: int | None = None) -> bytes:
    head = struct.pack("<QQQI", 0, 0, len(records) if size is None else size, zlib.crc32(records))
    name = compression.encode()
    return record(
        6, head + struct.pack("<I", len(name)) + name + struct.pack("<Q", len(packed)) + packed
    )


def unknown_records(writer: Writer, file: IO[bytes]) -> None:
    """Of a later version and of an application, outside and inside a chunk."""
    writer.flush()  # type: ignore[no-untyped-call]
    some = record(0x10, b"later") + record(0x80, b"") + record(0xFF, bytes(300))
    file.write(some + chunk(some, "", some))


def sizes_unstated(writer: Writer, file: IO[bytes]) -> None:
    """Chunks whose frames do not state their size."""
    writer.flush()  # type: ignore[no-untyped-call]
    some = record(0x80, bytes(5000))
    zstd = zstandard.ZstdCompressor(write_content_size=False).compress(some)
    file.write(chunk(some, "zstd", zstd))
    file.write(chunk(some, "lz4", lz4.frame.compress(some, store_size=False)))


NONE = IndexType.NONE
PERMITTED: dict[str, tuple[Extra | None, dict[str, Any]]] = {
    "zstd": (None, {}),
    "lz4": (None, {"compression": CompressionType.LZ4}),
    "not compressed": (None, {"compression": CompressionType.NONE}),
    "no checksums": (None, {"enable_crcs": False}),
    "no checksums, not compressed": (
        None,
        {"enable_crcs": False, "compression": CompressionType.NONE},
    ),
    "a checksum of the data": (None, {"enable_data_crcs": True}),
    "no chunks": (None, {"use_chunking": False}),
    "no index": (None, {"index_types": NONE, "use_summary_offsets": False}),
    "no summary": (
        None,
        {
            **{"index_types": NONE, "use_summary_offsets": False, "use_statistics": False},
            **{"repeat_channels": False, "repeat_schemas": False},
        },
    ),
    "one chunk": (None, {"chunk_size": 2**31}),
    "a chunk for each message": (None, {"chunk_size": 1}),
    "an attachment": (attachment, {}),
    "metadata of others": (other_metadata, {}),
    "channels of others": (foreign_channels, {}),
    "unknown records": (unknown_records, {}),
    "frames without a size": (sizes_unstated, {}),
}


@pytest.mark.short_rows(5)
@pytest.mark.parametrize(("extra", "options"), PERMITTED.values(), ids=PERMITTED)
def test_each_form_that_the_format_permits_is_read_as_our_own(
    recording: RecordedFile, tmp_path: Path, extra: Extra | None, options: dict[str, Any]
) -> None:
    path = rewritten(recording, tmp_path / "other.mcap", extra, **options)
    found = read_file(path)
    assert found.fault == ""
    assert [one for one in found.messages if one.topic not in ("/thing", "/raw")] == (
        recording.messages
    )
    _, parity = repeat([found], ORIGINS)
    assert parity.notes == ()
    assert parity.safe.is_equal
    surveyed = survey([path])
    assert ["2 topics" in fault for fault in surveyed.faults] == [True] * (
        extra is foreign_channels
    )
    whole = survey([recording.path])
    counts = [write_merged(place(one), tmp_path / "merged.mcap") for one in (surveyed, whole)]
    assert counts[0] == counts[1]
    assert read_timeline([path]).duration == read_timeline([recording.path]).duration
    platform = head_of(found.about, "").identity.platform
    played = ReplayDriver(swarm="s", robot="r", platform=platform, options={"file": str(path)})
    assert played.taken.maxlen


def test_a_compression_of_others_is_named(recording: RecordedFile, tmp_path: Path) -> None:
    path = rewritten(recording, tmp_path / "other.mcap", None)
    path.write_bytes(path.read_bytes().replace(b"\x04\0\0\0zstd", b"\x04\0\0\0lzma"))
    found = read_file(path)
    assert "'lzma'" in found.fault
    assert found.messages == []
    assert found.about == recording.about


def test_messages_that_are_missing_without_a_trace_are_counted(
    recording: RecordedFile, tmp_path: Path
) -> None:
    path = rewritten(recording, tmp_path / "other.mcap", None)
    data = bytearray(path.read_bytes())
    data[data.index(b"\x04\0\0\0zstd") - 37] = 0x66  # the code of the first chunk
    path.write_bytes(data)
    found = read_file(path)
    assert f"states {len(recording.messages)} messages" in found.fault
    assert 0 < len(found.messages) < len(recording.messages)


def repeated(count: int, *records: bytes) -> bytes:
    return b"\x89MCAP0\r\n" + count * b"".join(records)


def zeros() -> bytes:
    some = bytes(2**23)
    return repeated(60, chunk(some, "zstd", zstandard.compress(some)))


def large_record() -> bytes:
    some = record(9, bytes(2**23))
    return repeated(9, chunk(some, "lz4", lz4.frame.compress(some)))


def empty_messages() -> bytes:
    some = record(5, bytes(22)) * 2**17
    return repeated(1, chunk(some, "zstd", zstandard.compress(some)))


def size_of_no_file() -> bytes:
    return repeated(1, chunk(b"", "zstd", zstandard.compress(b""), 2**60))


def chunks_within_each_other() -> bytes:
    return repeated(2000, chunk(bytes(4000), "", bytes(4000))[:60])


BOMBS = (zeros, large_record, empty_messages, size_of_no_file, chunks_within_each_other)


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_file_never_takes_more_memory_than_a_ratio_to_its_size(
    tmp_path: Path, bomb: Callable[[], bytes]
) -> None:
    path, data = tmp_path / "bomb.mcap", bomb()
    path.write_bytes(data)
    tracemalloc.start()
    try:
        with suppress(ConfigError):
            assert read_file(path).fault
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 2 * (MAX_RATIO * len(data) + MAX_SPARE)


def test_a_file_beyond_the_ratio_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(empty_messages())
    with pytest.raises(ConfigError, match="unpack to") as caught:
        read_file(path)
    assert str(caught.value).isprintable()
