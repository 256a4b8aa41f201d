"""Recordings copied from robots: cut off, rotated, of equal names, and a full disk here."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
import zlib
from contextlib import nullcontext
from pathlib import Path

import pytest
from msgspec import structs

from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import NetworkError
from swarmd.core.verbs import FetchQuery, FetchReply, RecordingFile, RecordingsReply
from swarmd.daemon.recording.fetch import (
    INCIDENT,
    PIECE,
    RECORDING,
    Source,
    check_sizes,
    fetch,
    note_clock,
    read_exchanges,
)
from swarmd.operator.cli.options import CommonOptions
from swarmd.operator.cli.swarmctl import cli, exit_code_of, run_cli
from swarmd.operator.verbs.record import ask
from swarmd.operator.verbs.record import command as record

CONTENT = bytes(range(256)) * 500  # 128 kB


class Robots:
    """Robots with files; after `left` answers none comes. `pieces`: the offsets asked for."""

    def __init__(self, files: dict[tuple[str, str], bytes]) -> None:
        self.files = files
        self.left = 10**6
        self.pieces: list[int] = []

    def ask(self, robot: str, name: str, payload: bytes) -> bytes | None:
        if self.left <= 0:
            return None
        self.left -= 1
        if name == "recordings":
            reply = RecordingsReply(robot=robot, now=boottime() + 100.0, clock="00ff", files=())
            return encode(reply)
        query = Decoder(FetchQuery)(payload)
        self.pieces.append(query.offset)
        data = self.files.get((robot, query.file))
        piece = b"" if data is None else data[query.offset : query.offset + query.length]
        return encode(
            FetchReply(
                robot=robot,
                file=query.file,
                offset=query.offset,
                size=len(data or b""),
                data=piece,
                crc=zlib.crc32(piece),
                text="there is no such recording" if data is None else "",
            )
        )


def listed(data: bytes, *, is_open: bool = False, name: str = "a-00001.mcap") -> RecordingFile:
    crc = None if is_open else zlib.crc32(data)
    return RecordingFile(name=name, size=len(data), is_open=is_open, crc=crc)


def test_a_copy_that_was_cut_goes_on_where_it_ended(tmp_path: Path) -> None:
    robots = Robots({("r", "a-00001.mcap"): CONTENT})
    robots.left = 2
    with pytest.raises(NetworkError, match=r"a-00001\.mcap has 65536 bytes here"):
        fetch(robots.ask, "r", listed(CONTENT), tmp_path)
    robots.left, robots.pieces = 100, []
    done = fetch(robots.ask, "r", listed(CONTENT), tmp_path)
    assert (done.is_whole, done.received) == (True, len(CONTENT) - 2 * PIECE)
    assert robots.pieces == [0, 2 * PIECE, 3 * PIECE]  # the first one tells which recording it is
    assert done.path.read_bytes() == CONTENT
    assert [one.name for one in (tmp_path / "r").iterdir()] == ["a-00001.mcap"]
    assert fetch(robots.ask, "r", listed(CONTENT), tmp_path).received == 0


def test_a_file_that_is_finished_between_two_fetches_becomes_whole(tmp_path: Path) -> None:
    half = CONTENT[: len(CONTENT) // 2]
    robots = Robots({("r", "a-00001.mcap"): half})
    so_far = fetch(robots.ask, "r", listed(half, is_open=True), tmp_path)
    assert (so_far.is_whole, so_far.path.name) == (False, "a-00001.mcap.partial")
    robots.files = {("r", "a-00001.mcap"): CONTENT, ("r", "a-00002.mcap"): half}
    assert fetch(robots.ask, "r", listed(CONTENT), tmp_path).path.read_bytes() == CONTENT
    second = listed(half, name="a-00002.mcap")
    assert fetch(robots.ask, "r", second, tmp_path).is_whole
    assert len(list((tmp_path / "r").iterdir())) == 2


def test_a_file_that_the_robot_removes_meanwhile_is_named_and_keeps_what_came(
    tmp_path: Path,
) -> None:
    robots = Robots({("r", "a-00001.mcap"): CONTENT})

    def lose(received: int, size: int) -> None:
        robots.files.clear()

    done = fetch(robots.ask, "r", listed(CONTENT), tmp_path, lose)
    assert (done.is_whole, done.size, done.fault) == (False, PIECE, "there is no such recording")
    assert done.path.read_bytes() == CONTENT[:PIECE]


@pytest.mark.parametrize("ending", ["", ".partial"])
def test_a_file_of_another_recording_with_that_name_is_kept(tmp_path: Path, ending: str) -> None:
    old = tmp_path / "r" / f"a-00001.mcap{ending}"
    old.parent.mkdir()
    old.write_bytes(b"another" * 100)
    robots = Robots({("r", "a-00001.mcap"): CONTENT})
    assert fetch(robots.ask, "r", listed(CONTENT), tmp_path).path.read_bytes() == CONTENT
    kept = tmp_path / "r" / f"a-00001-other1.mcap{ending}"
    assert kept.read_bytes() == b"another" * 100


def test_robots_with_equal_names_of_files_have_folders_of_their_own(tmp_path: Path) -> None:
    robots = Robots({("r1", "a-00001.mcap"): CONTENT, ("r2", "a-00001.mcap"): CONTENT[::-1]})
    one = fetch(robots.ask, "r1", listed(CONTENT), tmp_path)
    other = fetch(robots.ask, "r2", listed(CONTENT[::-1]), tmp_path)
    assert (one.path.read_bytes(), other.path.read_bytes()) == (CONTENT, CONTENT[::-1])


def test_a_damaged_copy_is_removed(tmp_path: Path) -> None:
    robots = Robots({("r", "a-00001.mcap"): CONTENT})
    wrong = listed(CONTENT[:-1] + b"?")
    with pytest.raises(NetworkError, match="damaged; fetch again"):
        fetch(robots.ask, "r", wrong, tmp_path)
    assert list((tmp_path / "r").iterdir()) == []


@pytest.mark.parametrize(
    "name",
    [
        *("../x.mcap", "/etc/x.mcap", "x.txt", "..", "", "x\0.mcap", "\x1b]0;x\a.mcap"),
        f"{'x' * 250}.mcap",
    ],
)
def test_a_robot_chooses_no_place_here(tmp_path: Path, name: str) -> None:
    robots = Robots({("r", name): CONTENT})
    with pytest.raises(NetworkError, match="expected the name of a recording"):
        fetch(robots.ask, "r", listed(CONTENT, name=name), tmp_path / "here")
    assert list(tmp_path.iterdir()) == []


FULL = """
import resource, signal, sys
from pathlib import Path
from tests.daemon.recording.test_fetch import *
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (70_000, 70_000))
try:
    fetch(Robots({("r", "a-00001.mcap"): CONTENT}).ask, "r", listed(CONTENT), Path(sys.argv[1]))
except OSError as error:
    print(error.errno)
"""


@pytest.mark.integration
def test_a_full_disk_here_keeps_what_came_and_the_next_fetch_goes_on(tmp_path: Path) -> None:
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        timeout=60,
    )
    assert done.stdout.strip() == str(errno.EFBIG), done.stderr
    partial = tmp_path / "r" / "a-00001.mcap.partial"
    assert partial.read_bytes() == CONTENT[: partial.stat().st_size]
    assert partial.stat().st_size >= PIECE
    robots = Robots({("r", "a-00001.mcap"): CONTENT})
    assert fetch(robots.ask, "r", listed(CONTENT), tmp_path).path.read_bytes() == CONTENT


def test_the_clocks_of_operator_and_robot_are_noted(tmp_path: Path) -> None:
    robots = Robots({})
    for _ in range(2):
        note_clock(robots.ask, "r", tmp_path)
    noted = read_exchanges(tmp_path / "clocks.jsonl")
    assert [one.peer for one in noted] == ["00ff", "00ff"]
    assert all(one.sent + 99.0 < one.answered < one.returned + 101.0 for one in noted)
    with (tmp_path / "clocks.jsonl").open("a") as file:
        file.write('["cut o')
    assert read_exchanges(tmp_path / "clocks.jsonl") == noted


def test_a_robot_that_refuses_a_file_and_falls_silent_is_missing_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    robots = Robots({})
    robots.left = 2  # the recordings, and a refusal of the first file
    files = (listed(b"a"), listed(b"b", name="a-00002.mcap"))
    reply = RecordingsReply(robot="r", now=1.0, clock="00ff", files=files)
    monkeypatch.setattr(CommonOptions, "operator", lambda options: nullcontext())
    monkeypatch.setattr(record, "_recordings", lambda *_: ({"r": reply}, []))
    monkeypatch.setattr(ask, "ask_of", lambda session: robots.ask)
    words = ["record", "fetch", "--all", "-d", str(tmp_path), "-o", "json"]
    run_cli(cli, words, "swarmctl", exit_code_of)
    fetched = json.loads(capsys.readouterr().out)
    assert [file["state"] for file in fetched["files"]] == ["there is no such recording"]
    assert fetched["missing"] == ["r"]


# What a robot may state


class Liar(Robots):
    """A robot that answers each question with `length` bytes, or with as many as asked for."""

    def __init__(self, length: int | None = None) -> None:
        super().__init__({})
        self.length = length

    def ask(self, robot: str, name: str, payload: bytes) -> bytes | None:
        """As a robot whose file never ends."""
        query = Decoder(FetchQuery)(payload)
        self.pieces.append(query.offset)
        data = bytes(query.length if self.length is None else self.length)
        return encode(
            FetchReply(
                robot=robot, file=query.file, offset=query.offset, size=2**50, data=data,
                crc=zlib.crc32(data),
            )
        )  # fmt: skip


@pytest.mark.parametrize(
    ("source", "size"),
    [(INCIDENT, 2**26 + 1), (INCIDENT, 2**45), (RECORDING, 2**32 + 1), (RECORDING, 2**45)],
)
def test_a_size_that_no_file_of_the_kind_has_is_not_believed(
    tmp_path: Path, source: Source, size: int
) -> None:
    robot, name = Liar(), f"a-00001{source.suffix}"
    file = RecordingFile(name=name, size=size, is_open=False, crc=0)
    with pytest.raises(NetworkError, match=str(size)) as caught:
        fetch(robot.ask, "r", file, tmp_path, source=source)
    assert "\n" not in str(caught.value)
    assert robot.pieces == [], "nothing was asked for"
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_leaves_no_room_on_the_disk_is_not_fetched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = shutil.disk_usage(tmp_path)._replace(free=2 * PIECE)
    monkeypatch.setattr("shutil.disk_usage", lambda path: free)
    robots = Robots({("r", "a-00001.mcap"): CONTENT})
    with pytest.raises(NetworkError, match=str(2 * PIECE)):
        fetch(robots.ask, "r", listed(CONTENT), tmp_path / "new")
    assert robots.pieces == []
    half = tmp_path / "new" / "r" / "a-00001.mcap.partial"
    half.parent.mkdir(parents=True)
    half.write_bytes(CONTENT[: 2 * PIECE + 1000])  # what is here already needs no room
    assert fetch(robots.ask, "r", listed(CONTENT), tmp_path / "new").is_whole


def test_files_that_together_exceed_the_disk_are_refused_before_the_first(tmp_path: Path) -> None:
    one = listed(CONTENT)
    check_sizes("r", [one], tmp_path)
    many = [structs.replace(one, name=f"{n}.mcap", size=2**32) for n in range(10_000)]  # 43 TB
    with pytest.raises(NetworkError, match=str(10_000 * 2**32)):
        check_sizes("r", many, tmp_path)


@pytest.mark.parametrize("length", [0, 1, PIECE - 1])
def test_an_answer_shorter_than_asked_for_ends_the_copy(tmp_path: Path, length: int) -> None:
    robot = Liar(length)
    copy = fetch(robot.ask, "r", listed(CONTENT), tmp_path)
    assert (copy.is_whole, copy.size, len(robot.pieces)) == (False, length, 1)
    assert "shorter" in copy.fault


def test_an_answer_longer_than_asked_for_is_damaged(tmp_path: Path) -> None:
    robot = Liar(200)
    with pytest.raises(NetworkError, match="damaged"):
        fetch(robot.ask, "r", listed(CONTENT[:100]), tmp_path)


def test_a_file_that_grows_is_copied_up_to_the_size_that_was_listed(tmp_path: Path) -> None:
    robot = Liar()
    copy = fetch(robot.ask, "r", listed(CONTENT, is_open=True), tmp_path)
    assert (copy.size, copy.fault) == (len(CONTENT), "")
