"""Recorded robots of a crowd, with clocks of any uptime, are repeated to the bit, also together."""

from __future__ import annotations

import base64
import math
import shutil
import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from swarmd.daemon.recording import frames, messages
from swarmd.daemon.recording.head import RecordingHead, head_of
from swarmd.daemon.recording.merge import place, survey
from swarmd.daemon.recording.reader import read_file
from swarmd.operator.replay.replay import Life, prepare, recordings_of
from swarmd.operator.replay.swarm import first_difference, place_lives, repeat_together
from tests.support.clocked_crowd import crowd
from tests.support.recorded_crowd import ROUND_TRIP, clock_of, recorded_crowd
from tests.support.recorded_stories import ORIGINS, repeat, rewritten
from tests.support.swarmctl import swarmctl

pytestmark = pytest.mark.long

DAY = 86_400.0
SECONDS, APART, JOINED = 6.0, 7.0, 4.8


@pytest.mark.evidence
@pytest.mark.parametrize("seed", range(2, 12))
def test_each_robot_of_a_crowd_is_repeated(tmp_path: Path, seed: int) -> None:
    seconds, uptime = 8.0, (60.0, 600.0, DAY)[seed % 3]
    crowded = recorded_crowd(tmp_path, crowd(4, seconds), seed, seconds, uptime=uptime)
    assert min(crowded.active.values()) > 10
    for folder in sorted(tmp_path.iterdir()):
        recordings = recordings_of(map(read_file, sorted(folder.glob("*.mcap"))))
        assert len(recordings) == crowded.lives[folder.name]
        for files in recordings:
            _, parity = repeat(files, ORIGINS)
            assert parity.notes == ()
            assert parity.safe.is_equal
            assert parity.requested.is_equal
            assert parity.safe.count > 10
            assert parity.difference is None


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four robots, whose clocks are 7 s apart; tb3-03 is killed and starts again."""
    folder = tmp_path_factory.mktemp("crowd")
    made = recorded_crowd(folder, crowd(4, SECONDS), 1, SECONDS, uptime=60.0, apart=APART)
    assert min(made.active.values()) > 10
    return folder


def lives_in(folder: Path) -> list[Life]:
    paths = sorted(folder.rglob("*.mcap"))
    lives = [prepare(files, ORIGINS) for files in recordings_of(map(read_file, paths))]
    place_lives(lives, paths)
    return lives


def test_a_swarm_is_repeated_together_in_the_order_of_its_clocks(recorded: Path) -> None:
    lives = lives_in(recorded)
    repeat_together(lives)
    assert first_difference(lives) is None
    names = ["tb3-01", "tb3-02", "tb3-03", "tb3-03", "tb3-04"]
    assert [life.head.identity.robot for life in lives] == names
    for life, begin in zip(lives, (0.0, 0.0, 0.0, JOINED, 0.0), strict=True):
        parity = life.parity()
        assert parity.safe.is_equal
        assert parity.requested.is_equal
        assert parity.notes == ()
        # By their wall clocks these robots would begin 7 s apart.
        assert life.replay.begin == pytest.approx(begin, abs=0.02 + life.error)
        assert life.error < 2 * ROUND_TRIP


def test_the_first_robot_instant_and_field_that_differ_are_told(recorded: Path) -> None:
    lives = lives_in(recorded)
    _, second, *_, last = lives
    at = altered(second, 0.2)
    assert altered(last, 0.8) > at + 1.0
    repeat_together(lives)
    found = first_difference(lives)
    assert found is not None
    life, difference = found
    assert life.head.identity.robot == "tb3-02"
    assert difference.field == "safe"
    assert difference.at == pytest.approx(at, abs=1e-6)
    assert difference.last[-1][1] == pytest.approx(at, abs=1e-6)


def altered(life: Life, share: float) -> float:
    """Change the last bit of a recorded command, after a share of all messages; its time in s."""
    begin = round(share * len(life.messages))
    for number, message in enumerate(life.messages[begin:], start=begin):
        if message.topic == "/decision":
            decision = messages.deserialize(message.kind, message.payload)
            speed = struct.pack("<d", decision.safe.linear.x)
            other = struct.pack("<d", np.nextafter(decision.safe.linear.x, np.inf))
            if message.payload.count(speed) == 1:
                payload = message.payload.replace(speed, other)
                life.messages[number] = replace(message, payload=payload)
                return 1e-9 * (message.at - life.messages[0].at)
    raise AssertionError("no decision with a command of its own")


@pytest.mark.parametrize(
    "times", [(math.nan, 61.0, 61.0), (60.0, math.inf, 61.0), (60.0, 1e300, 61.0), (-1e308, 0, 0)]
)
def test_an_exchange_that_no_clock_can_have_is_left_out(
    recorded: Path, tmp_path: Path, times: tuple[float, float, float]
) -> None:
    entry = frames.ClockEntry(0.0, "tb3-01", clock_of("tb3-01"), *times)
    payload = messages.clock_message(entry, 0.0).payload
    paths = []
    for number, path in enumerate(sorted(recorded.rglob("*.mcap"))):
        file = read_file(path)
        changed = [
            replace(one, payload=payload) if one.topic == "/clock/pair" else one
            for one in file.messages[:60]
        ]
        other = replace(file, messages=changed)
        paths.append(rewritten(other, tmp_path / f"{number}.mcap"))
    placed = place(survey(paths))
    assert [one.alignment is None for one in placed] == [False, True, True, True]


@pytest.mark.parametrize(
    ("words", "robots", "seconds"),
    [
        (("--life", "2"), 1, SECONDS - JOINED),
        (("--why", "tb3-04", "--until", "2"), 4, 2.0),
    ],
)
def test_swarmctl_repeats_a_folder_of_robots(
    recorded: Path, words: Sequence[str], robots: int, seconds: float
) -> None:
    done = swarmctl("replay", str(recorded), *words, "-o", "json")
    assert done.code == 0, done.err
    found = done.json["robots"]
    assert len(found) == robots
    assert all(one["safe"]["count"] == one["safe"]["equal"] for one in found)
    assert max(one["seconds"] for one in found) == pytest.approx(seconds, abs=0.1)
    assert done.json["first_difference"] is None
    assert any("tb3-04" in line for line in done.json["why"]) == ("--why" in words)


@pytest.mark.parametrize("words", [("--life", "3"), ("--why", "tb3-09")])
def test_a_life_or_robot_that_is_not_there_is_refused(recorded: Path, words: Sequence[str]) -> None:
    assert swarmctl("replay", str(recorded), *words).code == 2


def another(recorded: Path, folder: Path, robot: str, about: Mapping[str, str]) -> Path:
    """A copy of the crowd in `folder`, in which the files of a robot have other texts."""
    shutil.copytree(recorded, folder)
    for path in (folder / robot).glob("*.mcap"):
        file = read_file(path)
        rewritten(replace(file, about={**file.about, **about}), path)
    return folder


def head_in(recorded: Path, robot: str) -> RecordingHead:
    path = min((recorded / robot).glob("*.mcap"))
    return head_of(read_file(path).about, "")


def test_a_robot_that_cannot_be_repeated_makes_the_swarm_unequal(
    recorded: Path, tmp_path: Path
) -> None:
    nested = b"\x81\xa1x" + 200_000 * b"\x91" + b"\xc0"  # MessagePack, a list in a list in ...
    head = base64.b64encode(nested).decode()
    folder = another(recorded, tmp_path / "crowd", "tb3-02", {"head": head})
    done = swarmctl("replay", str(folder), "-o", "json")
    assert done.code == 1
    assert [one["robot"] for one in done.json["robots"]] == ["tb3-01", "tb3-03", "tb3-04"]
    assert done.json["is_equal"] is False
    assert len(done.err.splitlines()) == 1


def test_times_of_the_first_robot_that_no_float_holds_are_exact(
    recorded: Path, tmp_path: Path
) -> None:
    file = read_file(min((recorded / "tb3-01").glob("*.mcap")))
    wall, boot = (10**400 + int(file.about[name]) for name in ("wall_ns", "boot_ns"))
    about = {"wall_ns": str(wall), "boot_ns": str(boot)}
    folder = another(recorded, tmp_path / "crowd", "tb3-01", about)
    done = swarmctl("replay", str(folder), "-o", "json")
    assert done.code == 0, done.err
    assert len(done.json["robots"]) == 4


def test_a_name_with_control_characters_is_printed_in_one_line(
    recorded: Path, tmp_path: Path
) -> None:
    head = head_in(recorded, "tb3-02")
    identity = structs.replace(head.identity, robot="tb3\n-02\x1b[31m")
    texts = structs.replace(head, identity=identity).texts()
    done = swarmctl("replay", str(another(recorded, tmp_path / "crowd", "tb3-02", texts)))
    lines = done.out.splitlines()
    assert len(lines) == 4 + 1 + 8
    assert all(line.isprintable() for line in lines)


def test_two_swarms_in_one_folder_are_told(recorded: Path, tmp_path: Path) -> None:
    texts = structs.replace(head_in(recorded, "tb3-02"), swarm="another").texts()
    done = swarmctl("replay", str(another(recorded, tmp_path / "crowd", "tb3-02", texts)))
    assert "2 swarms" in done.err
    assert "swarms" not in swarmctl("replay", str(recorded)).err


@pytest.mark.parametrize("until", ["900ms", "nan", "-1", "0"])
def test_an_end_before_all_decisions_is_refused_in_one_line(
    recorded: Path, tmp_path: Path, until: str
) -> None:
    file = read_file(min((recorded / "tb3-01").glob("*.mcap")))
    at = file.messages[0].at + 10**9
    later = [one for one in file.messages if one.topic != "/decision" or one.at > at]
    path = rewritten(replace(file, messages=later), tmp_path / "later.mcap")
    done = swarmctl("replay", str(path), "--until", until)
    assert done.code == 2
    assert "--until" in done.err
    assert len(done.err.splitlines()) == 1


def test_a_difference_has_one_instant_in_all_outputs(recorded: Path, tmp_path: Path) -> None:
    folder = tmp_path / "crowd"
    shutil.copytree(recorded, folder)
    first_file, second_file = map(read_file, sorted((folder / "tb3-03").glob("*.mcap")))
    driving = next(
        one.payload
        for one in first_file.messages
        if one.topic == "/decision" and messages.deserialize(one.kind, one.payload).safe.linear.x
    )
    changed = list(second_file.messages)  # of the second life, which begins later
    number = [at for at, one in enumerate(changed) if one.topic == "/decision"][9]
    changed[number] = replace(changed[number], payload=driving)
    rewritten(replace(second_file, messages=changed), second_file.path)
    done = swarmctl("replay", str(folder), "--why", "tb3-03", "-o", "json")
    assert done.code == 1
    (row,) = (one for one in done.json["robots"] if one["robot"] == "tb3-03")
    first = done.json["first_difference"]
    assert row["safe"]["first"] == first["at"] > JOINED
    assert done.json["why"][-1].split()[0] == f"{first['at']:.3f}"
