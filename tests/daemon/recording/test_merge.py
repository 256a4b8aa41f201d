"""Recordings of several robots merged onto one timeline, with real files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from swarmd.core.errors import ConfigError
from swarmd.core.events import OdometryInput
from swarmd.core.values import Odometry, Pose, Twist
from swarmd.daemon.recording.clock_offset import Exchange
from swarmd.daemon.recording.frames import Begin, ClockEntry, input_entry
from swarmd.daemon.recording.merge import place, survey, write_merged
from swarmd.daemon.recording.process import Converter
from swarmd.daemon.recording.reader import read_file
from swarmd.operator.cli.swarmctl import cli
from swarmd.settings.file_limits import FileLimits

WALLS = {"a": 1.7e9, "b": 0.0, "c": 1.5e9}
"""The wall clock of each robot at its first message; that of b begins in 1970."""
BOOTS = {"a": 50.0, "b": 10_850.0, "c": 7.0}
"""Boottime at true time 0: b is three hours ahead of a."""


def record(folder: Path, robot: str, *, hears: str = "", clock: str = "") -> Path:
    """Odometry each second for 20 s, x being the true time, and an exchange each 5 s."""
    boot = BOOTS[robot]
    about = {"robot": robot, "clock": clock or f"clock-{robot}"}
    converter = Converter(
        Begin(boot, str(folder / robot), robot, about, WALLS[robot], FileLimits())
    )
    for k in range(21):
        reading = Odometry(0.0, Pose(k, 0.0, 0.0), Twist())
        converter.add(input_entry(OdometryInput(reading), boot + k))
        if hears and k % 5 == 0:
            sent, answered = boot + k, BOOTS[hears] + k + 0.002
            peer = f"clock-{hears}"
            converter.add(ClockEntry(boot + k, hears, peer, sent, answered, sent + 0.004))
    converter.writer.close()
    assert converter.writer.path is not None
    return converter.writer.path


def messages_of(path: Path) -> list[tuple[str, float, float]]:
    """Topic, true time by the message, and seconds on the timeline, of each odometry."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, decoded.pose.pose.position.x, 1e-9 * message.log_time - WALLS["a"])
            for _, channel, message, decoded in reader.iter_decoded_messages()
            if channel.topic.endswith("/odometry")
        ]


def test_the_timeline_is_the_wall_clock_of_the_first_robot(tmp_path: Path) -> None:
    paths = [record(tmp_path, "a", hears="b"), record(tmp_path, "b")]
    placed = place(survey(paths))
    out = tmp_path / "all.mcap"
    assert write_merged(placed, out) == 2 * 21 + 5
    found = messages_of(out)
    assert {topic for topic, _, _ in found} == {"/a/odometry", "/b/odometry"}
    assert [seconds for _, true, seconds in found] == pytest.approx(
        [true for _, true, seconds in found], abs=0.003
    )
    assert [seconds for _, _, seconds in found] == sorted(seconds for _, _, seconds in found)
    alignment = placed[1].alignment
    assert alignment is not None
    assert alignment.offset == pytest.approx(10_800.0, abs=alignment.error)
    assert alignment.error < 0.005
    about = read_file(out).about
    assert (about["kind"], about["reference"], about["robots"]) == ("merged", "a", "a,b")
    assert json.loads(about["clocks"])[1]["error"] == alignment.error
    other = place(survey(paths), "b")
    assert other[0].source.robot == "b"
    assert other[1].alignment is not None
    assert other[1].alignment.offset == pytest.approx(-10_800.0, abs=alignment.error)


def test_robots_on_one_machine_share_a_clock(tmp_path: Path) -> None:
    paths = [record(tmp_path, robot, clock="one") for robot in ("a", "b")]
    assert [one.alignment.error for one in place(survey(paths)) if one.alignment] == [0.0, 0.0]


def test_exchanges_with_the_operator_align_robots_that_did_not_hear_each_other(
    tmp_path: Path,
) -> None:
    paths = [record(tmp_path, "a"), record(tmp_path, "b")]
    lines = [
        Exchange("laptop", f"clock-{robot}", 30.0, BOOTS[robot] + 30.01, 30.02) for robot in "ab"
    ]
    (tmp_path / "clocks.jsonl").write_text("".join(json.dumps(one) + "\n" for one in lines))
    alignment = place(survey(paths))[1].alignment
    assert alignment is not None
    assert alignment.via == ("laptop",)
    assert abs(alignment.offset - 10_800.0) < alignment.error < 0.1


def merge(*words: object) -> tuple[int, str]:
    done = CliRunner().invoke(cli, ["record", "merge", *map(str, words)])
    return done.exit_code, f"{done.output}{done.exception or ''}"


def test_robots_without_a_path_are_refused_or_called_unaligned(tmp_path: Path) -> None:
    for robot, hears in (("a", "b"), ("b", ""), ("c", "")):
        record(tmp_path, robot, hears=hears)
    out = tmp_path / "all.mcap"
    code, text = merge(tmp_path, "-o", out)
    assert code == 2
    assert "c: no exchange with the clock of a" in text
    assert not out.exists()
    code, text = merge(tmp_path, "-o", out, "--unaligned")
    assert code == 0, text
    (row,) = (line for line in text.splitlines() if line.startswith("c "))
    assert "unaligned" in row
    assert "3 robots" in text
    rows = json.loads(read_file(out).about["clocks"])
    assert [one["is_aligned"] for one in rows] == [True, True, False]
    assert {round(s - t) for topic, t, s in messages_of(out) if topic[1] == "c"} == {-200_000_000}


def test_mistakes_are_one_line_and_leave_nothing(tmp_path: Path) -> None:
    path = record(tmp_path / "in", "a")
    for words, fault in (
        ((path,), "expected one -o OUT.mcap"),
        ((path, "-o", "x.bag"), "expected one -o OUT.mcap"),
        ((path, "-o", tmp_path / "no" / "x.mcap"), "no such folder"),
        ((path, "-o", path), "exists"),
        ((tmp_path / "in" / "a", "-o", tmp_path / "x.mcap", "--reference", "z"), "robot 'z'"),
    ):
        code, text = merge(*words)
        assert code != 0
        assert fault in text, (words, text)
    write_merged(place(survey([path])), tmp_path / "x.mcap")
    with pytest.raises(ConfigError, match="merged already"):
        survey([tmp_path / "x.mcap"])
    assert sorted(one.name for one in tmp_path.iterdir()) == ["in", "x.mcap"]


@pytest.mark.parametrize(
    ("text", "damaged"), [(b"boot_ns", b"boot_nz"), (b"10850000000000", b"1085000x000000")]
)
def test_damaged_texts_on_a_clock_are_one_line(tmp_path: Path, text: bytes, damaged: bytes) -> None:
    path = record(tmp_path, "b")
    path.write_bytes(path.read_bytes().replace(text, damaged))
    code, told = merge(path, "-o", tmp_path / "x.mcap")
    assert code != 0
    assert (told.count("\n"), str(path) in told, "boot_ns" in told) == (0, True, True)
    assert not (tmp_path / "x.mcap").exists()


def test_a_file_that_cannot_be_finished_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    placed = place(survey([record(tmp_path / "in", "a")]))

    def full(self: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("mcap.writer.Writer.finish", full)
    with pytest.raises(OSError, match="No space left"):
        write_merged(placed, tmp_path / "x.mcap")
    assert [one.name for one in tmp_path.iterdir()] == ["in"]
