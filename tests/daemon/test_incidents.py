"""Which files of incidents give way, whose tales count, and what a killed writer leaves."""

from __future__ import annotations

import asyncio
import os
import struct
import time
import zlib
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.clock import boottime, clock_id
from swarmd.core.codec import Decoder, encode
from swarmd.core.incident import Found, Incident, IncidentKind, ToldIncident, mark_part, silent_id
from swarmd.core.messages import Code, Reply, State
from swarmd.core.verbs import FetchQuery, IncidentsReply, KeptIncident, MarkRequest, Nothing
from swarmd.daemon.incident_budget import MAX_BYTES, MAX_KEPT, teller_to_give_way, to_remove
from swarmd.daemon.incidents import IncidentService, _checked, _signed, _Told
from swarmd.daemon.recorder import Recorder
from swarmd.daemon.recording import frames
from swarmd.daemon.recording.head import RecordingHead
from swarmd.daemon.recording.incident_file import IncidentHead, read, read_head
from swarmd.daemon.recording.ring import Ring, entries_of, read_left, remove_old, ring_folder
from swarmd.link.datagram import STATES, Beacon
from swarmd.link.keys.content_signature import Purpose, sign
from swarmd.link.keys.identity import Identity
from swarmd.link.keys.private_keys import load_private_key
from swarmd.operator.verbs.incidents.ask import mark_fields
from swarmd.robot.setup import RobotIdentity, RobotSetup
from swarmd.settings.platforms import load_platform
from swarmd.settings.swarmfile import BlackboxSection
from tests.support.examples import examples
from tests.support.keys import SwarmKeys

MEGABYTE = 2**20


def incident(id: str, by: str = "r1", kind: str = IncidentKind.ESTOP) -> Incident:
    return Incident(id=id, robot=by, kind=kind, text="a cat", by=by)


def kept(
    *told: Incident, size: int = MEGABYTE, operator: str = "", source: str = ""
) -> list[KeptIncident]:
    return [
        KeptIncident(
            incident=one, age=None, file=f"{one.id}.incident", size=size, operator=operator,
            source=source,
        )
        for one in told
    ]  # fmt: skip


def file(id: str, by: str = "r1", kind: str = IncidentKind.ESTOP, **more: Any) -> KeptIncident:
    (one,) = kept(incident(id, by, kind), **more)
    return one


def with_new(files: list[KeptIncident], *new: KeptIncident) -> list[KeptIncident]:
    """The files that a robot keeps after it has written further ones."""
    for one in new:
        gone = to_remove(files, one)
        files = [*(old for old in files if old.incident.id not in gone), one]
        assert len(files) <= MAX_KEPT
    return files


def ids(files: list[KeptIncident]) -> set[str]:
    return {one.incident.id for one in files}


WOLF_KINDS = list(IncidentKind)  # it tells each kind, so that some are the first of theirs


def test_a_robot_that_tells_too_much_hides_only_what_it_told() -> None:
    honest = [file(f"h{n}", f"r{n}", IncidentKind.HAZARD) for n in range(6)]
    wolf = [file(f"w{n}", "wolf", WOLF_KINDS[n % len(WOLF_KINDS)]) for n in range(200)]
    assert ids(with_new(honest, *wolf)) >= ids(honest)


@pytest.mark.parametrize("kind", list(IncidentKind))
def test_no_robot_takes_the_share_of_the_marks_of_operators(kind: str) -> None:
    marks = [file(f"m{n}", f"r{n % 3}", IncidentKind.MARK, operator="anna") for n in range(10)]
    wolf = [file(f"w{n}", "wolf", kind) for n in range(60)]
    relays = [file(f"x{n}", f"r{n % 3}", kind, source="wolf") for n in range(60)]
    assert ids(with_new(marks, *wolf, *relays)) >= ids(marks)


def test_words_that_no_operator_has_signed_are_those_of_the_robot() -> None:
    """Of marks that a robot tells in the name of others, its own give way, and theirs stay."""
    heard = [file(f"m{n}", f"r{n}", IncidentKind.MARK) for n in range(8)]
    wolf = [file(f"w{n}", "wolf", IncidentKind.MARK) for n in range(60)]
    assert ids(with_new(heard, *wolf)) >= ids(heard)


def test_an_operator_displaces_the_marks_of_that_operator() -> None:
    marks = [file(f"b{n}", kind=IncidentKind.MARK, operator="bob") for n in range(4)]
    more = [file(f"a{n}", kind=IncidentKind.MARK, operator="anna") for n in range(30)]
    left = ids(with_new(marks, *more))
    assert left >= ids(marks)
    assert {f"a{n}" for n in range(24, 30)} == left - ids(marks)


def test_old_tales_that_a_peer_tells_again_displace_nothing_of_their_robot() -> None:
    own = [file(f"o{n}", "r2", IncidentKind.HAZARD) for n in range(9)]
    again = [file(f"x{n}", "r2", IncidentKind.HAZARD, source="wolf") for n in range(60)]
    assert ids(with_new(own, *again)) >= ids(own)


def test_a_robot_with_few_incidents_takes_room_from_one_with_many() -> None:
    many = [file(f"m{n}", "r1") for n in range(MAX_KEPT)]
    assert to_remove(many, file("new", "r2", IncidentKind.HAZARD)) == ["m1"]  # m0: first of a kind


def test_a_file_that_is_written_again_displaces_none() -> None:
    files = [file(f"i{n}", f"r{n}") for n in range(MAX_KEPT)]
    assert to_remove(files, files[3]) == []


def test_the_first_of_each_kind_stays_and_the_oldest_of_the_rest_goes() -> None:
    kinds = list(IncidentKind)[:4]
    files = [file(f"i{n}", kind=kinds[n % 4]) for n in range(MAX_KEPT)]
    assert to_remove(files, file("new")) == ["i4"]


def test_unknown_kinds_of_a_stranger_are_not_firsts() -> None:
    files = [file(f"i{n}", kind=f"kind{n}") for n in range(MAX_KEPT)]
    assert to_remove(files, file("new")) == ["i0"]


def test_marks_of_operators_take_at_most_half() -> None:
    estops = [file(f"e{n}") for n in range(5)]
    mark = partial(file, kind=IncidentKind.MARK, operator="anna")
    marks = [mark(f"m{n}") for n in range(MAX_KEPT // 2)]
    # The first file of a kind goes last.
    assert to_remove([*estops, *marks], mark("new")) == ["m1"]
    large = [*(file(f"e{n}", size=1000) for n in range(5)), mark("m0", size=MAX_BYTES // 2 - 10)]
    assert to_remove(large, mark("new", size=11)) == ["m0"]


def test_claimed_marks_give_way_to_those_of_operators_and_take_at_most_half_with_them() -> None:
    claim = partial(file, kind=IncidentKind.MARK)
    estops = [file(f"e{n}") for n in range(5)]
    claims = [claim(f"c{n}", f"r{n}") for n in range(MAX_KEPT // 2)]
    mark = claim("m0", operator="anna")
    assert to_remove([*estops, *claims], mark) == ["c0"]
    assert to_remove([*estops, mark, *claims[1:]], claim("new", "r3")) == ["c3"]


def test_files_are_limited_by_their_bytes() -> None:
    files = [file(f"i{n}", size=MAX_BYTES // 4) for n in range(4)]
    assert to_remove(files, file("new", size=MAX_BYTES // 2)) == ["i1", "i2"]


@settings(max_examples=examples(200))
@given(st.data())
def test_whoever_tells_what_stays_within_the_limits_and_no_mark_gives_way_to_a_robot(
    data: st.DataObject,
) -> None:
    names, kinds = st.sampled_from(["r1", "r2", "wolf"]), st.sampled_from([*IncidentKind, "new"])
    files: list[KeptIncident] = []
    for number in range(data.draw(st.integers(0, 60))):
        new = file(
            f"{number}", data.draw(names), data.draw(kinds),
            operator=data.draw(st.sampled_from(["", "", "anna", "bob"])),
            source=data.draw(st.sampled_from(["", "r3"])),
            size=data.draw(st.sampled_from([0, MEGABYTE, MAX_BYTES // 4])),
        )  # fmt: skip
        gone = to_remove(files, new)
        left = [one for one in files if one.incident.id not in gone]
        assert len(gone) == len(set(gone)) == len(files) - len(left)
        assert new.operator or not any(one.operator for one in files if one not in left)
        files = [*left, new]
        marks = [one for one in files if one.operator]
        assert len(files) <= MAX_KEPT
        assert len(marks) <= MAX_KEPT // 2
        assert sum(one.size for one in marks) <= MAX_BYTES // 2


@pytest.mark.parametrize(
    ("tellers", "new", "gone"),
    [
        ({"a": "wolf", "b": "wolf", "c": "r2"}, "r3", "a"),
        ({"a": "wolf", "b": "wolf", "c": "r2"}, "wolf", None),
        ({"a": "r2", "b": "wolf", "c": "r3"}, "r4", None),  # nobody has more than a fair share
        ({"a": "me", "b": "wolf", "c": "r2"}, "me", "b"),
        ({"a": "me", "b": "me"}, "me", "a"),
        ({"a": "me", "b": "me"}, "wolf", None),
    ],
)
def test_who_gives_way_in_a_full_list(tellers: dict[str, str], new: str, gone: str | None) -> None:
    assert teller_to_give_way(tellers, new, "me") == gone


# What peers tell


def listed(*told: ToldIncident | None) -> bytes:
    return msgspec.msgpack.encode([one for one in told if one is not None])


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> SwarmKeys:
    folder = tmp_path_factory.mktemp("keys")
    return SwarmKeys(folder, "meadow", ("r1", "r2", "r3"), operators=("anna",))


def test_an_incident_counts_if_its_robot_has_signed_it(keys: SwarmKeys) -> None:
    told = _signed(incident("aaaaaaaaaaaa", "r1"), keys["r1"])
    assert told is not None
    found = _checked(listed(told), keys["r3"], ())
    assert not isinstance(found, str), found
    assert [one.incident.by for one in found] == ["r1"]
    assert _checked(listed(told), keys["r3"], {"aaaaaaaaaaaa"}) == []


@pytest.mark.parametrize(("name", "signer"), [("r1", "r2"), ("r1", "anna"), ("anna", "anna")])
def test_an_incident_that_another_name_signed_is_refused(
    keys: SwarmKeys, name: str, signer: str
) -> None:
    told = _signed(incident("aaaaaaaaaaaa", name), keys[signer])
    true = _signed(incident("bbbbbbbbbbbb", "r2"), keys["r2"])
    found = _checked(listed(told, true), keys["r3"], ())
    assert not isinstance(found, str), found
    assert [one.incident.id for one in found] == ["bbbbbbbbbbbb"]


def test_an_incident_of_another_authority_or_unsigned_or_changed_is_refused(
    keys: SwarmKeys, tmp_path: Path
) -> None:
    other = SwarmKeys(tmp_path, "meadow", ("r1",))
    told = _signed(incident("aaaaaaaaaaaa", "r1"), keys["r1"])
    assert told is not None
    content = msgspec.msgpack.encode(incident("abababababab", "r1"))
    for wrong in (
        _signed(incident("aaaaaaaaaaaa", "r1"), other["r1"]),
        _signed(incident("aaaaaaaaaaaa", "r1"), None),
        msgspec.structs.replace(told, content=content),
        msgspec.structs.replace(told, certificate=b""),
        msgspec.structs.replace(told, signature=b"\0" * 64),
    ):
        assert _checked(listed(wrong), keys["r3"], ()) == []


@settings(max_examples=examples(200))
@given(
    st.one_of(
        st.binary(max_size=300),
        st.lists(
            st.builds(
                ToldIncident,
                content=st.one_of(
                    st.binary(max_size=99),
                    st.builds(lambda text: msgspec.msgpack.encode(incident(text)), st.text()),
                ),
                age=st.floats(0.0, 1e9),
                signature=st.binary(max_size=64),
                certificate=st.binary(max_size=99),
            ),
            max_size=3,
        ).map(msgspec.msgpack.encode),
    )
)
def test_no_list_raises(blob: bytes) -> None:
    assert isinstance(_checked(blob, None, ()), list | str)


# The ring


class Answers(list[Reply]):
    """The replies to requests."""

    def __call__(self, reply: Reply, *, is_stored: bool = True, is_audited: bool = True) -> None:
        self.append(reply)


@settings(max_examples=examples(60), deadline=None)
@given(
    sizes=st.lists(st.integers(0, 300), min_size=1, max_size=60),
    dies_at=st.integers(1, 400),
    share=st.floats(0.0, 1.0),
    every=st.integers(1, 9),
)
def test_a_writer_that_dies_at_any_write_leaves_whole_frames(
    tmp_path_factory: pytest.TempPathFactory,
    sizes: list[int],
    dies_at: int,
    share: float,
    every: int,
) -> None:
    path = tmp_path_factory.mktemp("ring") / "ring"
    calls = 0
    written = -1

    class Dead(BaseException):
        pass

    def pwrite(file: int, data: bytes, at: int) -> int:
        nonlocal calls
        calls += 1
        if calls == dies_at:  # the kernel has copied a part; a header lies in a single page
            cut = round(share) if at == 0 else share
            _pwrite(file, data[: round(cut * len(data))], at)
            raise Dead
        return _pwrite(file, data, at)

    _pwrite = os.pwrite
    made = None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "pwrite", pwrite)
        try:
            made = Ring(path, {"a": "b"}, capacity=2000, seconds=20.0, boot=1.0, wall=2.0)
            for number, size in enumerate(sizes):
                if number % every == 0:
                    made.begin_segment(float(number))
                entry = frames.EventEntry(float(number), "x" * size)
                made.write(frames.batch([frames.encode(entry)]))
                written = number
        except Dead:
            pass
    if made is None:
        return
    made.close()
    left = read_left(path)
    assert left is not None
    entries = entries_of(left)
    times = [entry.at for entry in entries]
    assert times == [float(n) for n in range(int(times[0]), int(times[-1]) + 1)] if times else True
    assert all(one == frames.EventEntry(one.at, "x" * sizes[int(one.at)]) for one in entries)
    if times:
        assert times[-1] in (written, written + 1)
        assert times[0] % every == 0


def test_a_frame_is_one_write_and_a_header_comes_only_with_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places: list[int] = []
    _pwrite = os.pwrite

    def pwrite(file: int, data: bytes, at: int) -> int:
        places.append(at)
        return _pwrite(file, data, at)

    monkeypatch.setattr(os, "pwrite", pwrite)
    made = Ring(tmp_path / "ring", {}, capacity=10_000, seconds=9.0, boot=1.0, wall=2.0)
    made.begin_segment(0.0)
    places.clear()
    frame = frames.batch([frames.encode(frames.EventEntry(1.0, "x" * 40))])
    for _ in range(100):
        made.write(frame)
    assert (len(places), places.count(0)) == (100, 0)  # 100 frames fit into the ring
    made.revision = 3
    made.write(frame)
    made.set_clock(2.0, 3.0)
    made.write(frame)
    made.begin_segment(20.0)
    made.begin_segment(30.0)  # drops the first one, which ended 10 s before
    made.write(frame)
    assert places[100:].count(0) == 3
    left = made.left()
    made.close()
    assert (left.revision, left.boot, left.wall) == (3, 2.0, 3.0)
    assert len(entries_of(left)) == 1


def test_an_equal_frame_of_the_round_before_is_not_believed(tmp_path: Path) -> None:
    frame = frames.batch([frames.encode(frames.EventEntry(1.0, "x" * 81))])
    capacity = 10 * (8 + len(frame))  # so frames of the next round lie exactly over these
    made = Ring(tmp_path / "ring", {}, capacity=capacity, seconds=9.0, boot=1.0, wall=2.0)
    for _ in range(5):
        made.begin_segment(1.0)
        for _ in range(3):
            made.write(frame)
    left = made.left()
    made.close()
    assert len(entries_of(left)) == 9  # of 15: three segments of three, of room for ten


@pytest.mark.parametrize("cut", [0, 1, 7, 8, 9, 20, 60, 109])
def test_a_frame_that_was_written_in_part_over_an_old_one_is_not_believed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut: int
) -> None:
    """The rest of the old frame would complete it, but for the checksum."""
    old, new = (
        frames.batch([frames.encode(frames.EventEntry(1.0, letter * 81))]) for letter in "xy"
    )
    _pwrite = os.pwrite

    def pwrite(file: int, data: bytes, at: int) -> int:
        return _pwrite(file, data if at == 0 else data[:cut], at)

    made = Ring(tmp_path / "ring", {}, capacity=3 * 110, seconds=9.0, boot=1.0, wall=2.0)
    for _ in range(4):
        made.begin_segment(1.0)
        made.write(old)
    monkeypatch.setattr(os, "pwrite", pwrite)
    made.begin_segment(1.0)
    made.write(new)
    left = made.left()
    made.close()
    assert [one.text for one in entries_of(left) if isinstance(one, frames.EventEntry)] == [
        "x" * 81,
        "x" * 81,
    ]


def test_the_ring_of_the_version_before_is_read(tmp_path: Path) -> None:
    """Its header counts the frames, which have no checksums; bytes as 0.2.0 wrote them."""
    entries = [frames.EventEntry(float(number), "x" * 20) for number in range(5)]
    packed = [frames.batch([frames.encode(one)]) for one in entries]
    content = b"".join(struct.pack("<I", len(one)) + one for one in packed)
    capacity, tail = 4 * len(content) // 3, len(content)  # the frames go beyond the end
    begin = tail % capacity
    circle = bytearray(capacity)
    for number, byte in enumerate(content):
        circle[(begin + number) % capacity] = byte
    header = struct.pack(
        "<8sQQddQI", b"swarmd1\0", tail, tail + len(content), 1.0, 2.0, 7, capacity
    )
    about = msgspec.msgpack.encode({"robot": "a"})
    path = tmp_path / "ring"
    path.write_bytes(
        header.ljust(64, b"\0") + bytes(circle) + struct.pack("<I", len(about)) + about
    )
    left = read_left(path)
    assert left is not None
    assert (left.about, left.revision) == ({"robot": "a"}, 7)
    assert entries_of(left) == entries


def test_a_ring_that_a_process_writes_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "ring"
    made = Ring(path, {}, capacity=1000, seconds=9.0, boot=1.0, wall=2.0)
    assert read_left(path) is None
    with pytest.raises(BlockingIOError):
        Ring(path, {}, capacity=1000, seconds=9.0, boot=1.0, wall=2.0)
    made.close(keeps_file=False)
    assert not path.exists()


def test_the_folder_in_memory_is_of_this_user_alone(tmp_path: Path) -> None:
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    (tmp_path / "link").symlink_to(tmp_path)
    for name in ("open", "link"):
        with pytest.raises(OSError, match="alone"):
            ring_folder(str(tmp_path / name), {})
    made = ring_folder(None, {"RUNTIME_DIRECTORY": str(tmp_path / "run")})
    assert made.stat().st_mode & 0o777 == 0o700


def test_only_old_rings_are_removed_from_the_folder(tmp_path: Path) -> None:
    Ring(tmp_path / "ring", {}, capacity=1000, seconds=9.0, boot=1.0, wall=2.0).close()
    (tmp_path / "of_0.2.0").write_bytes(b"swarmd1\0" + bytes(100))
    (tmp_path / "thesis").write_text("of an operator")
    os.mkfifo(tmp_path / "pipe")  # to open it would wait for a writer
    for path in tmp_path.iterdir():
        os.utime(path, (0.0, 0.0))
    remove_old(tmp_path, 86401.0)
    assert {path.name for path in tmp_path.iterdir()} == {"thesis", "pipe"}


# The service


class Service:
    """The incidents of a robot with a recorder whose entries a test adds."""

    def __init__(self, folder: Path) -> None:
        self.events: list[str] = []
        self.answers: list[Reply] = []
        self.recorder = Recorder(asyncio.get_running_loop(), self.events.append)
        self.folder = folder / "state"
        self.identity: Identity | None = None
        self.service = IncidentService(
            "r1", self.folder, BlackboxSection(folder=str(folder / "memory")),
            recorder=self.recorder, puller=MagicMock(), head=lambda: HEAD,
            identity=lambda: self.identity, is_member=lambda name: True,
            on_event=self.events.append,
        )  # fmt: skip
        self.service.open()

    def keep(self, *entries: frames.Entry) -> None:
        """A segment of the ring."""
        ring = self.recorder.black_box.ring
        assert ring is not None
        ring.begin_segment(entries[0].at)
        ring.write(frames.batch([frames.encode(one) for one in entries]))

    def die(self) -> None:
        """Leave the ring as a daemon that is killed."""
        assert self.recorder.black_box.ring is not None
        self.recorder.black_box.ring.close()

    def tell(self, *incidents: Incident, giver: str = "r9", age: float = 0.0) -> None:
        """A peer hands these on, as being `age` s old."""
        told = [_Told(one, -age, _signed(one, None)) for one in incidents]
        self.service._on_checked(giver, boottime(), told)

    def mark(self, id: str) -> None:
        request = MarkRequest(id="m", operator="anna", targets={"r1": None}, words="w", incident=id)
        self.service.on_mark(request, self.answer)

    def answer(self, reply: Reply, *, is_stored: bool = True, is_audited: bool = True) -> None:
        self.answers.append(reply)

    async def advance(self, seconds: float) -> None:
        """What is due after these seconds; waits for the threads."""
        self.service.advance(boottime() + seconds)
        await self.threads()

    async def threads(self) -> None:
        """Wait for the threads, also for those that they begin."""
        while self.service._tasks:
            await asyncio.gather(*self.service._tasks)
            await asyncio.sleep(0)  # the callbacks of the tasks

    def heads(self) -> dict[str, IncidentHead]:
        """The heads of its files by id."""
        paths = (self.folder / "incidents").glob("*.incident")
        return {path.stem: read_head(path.read_bytes()) for path in paths}

    def files(self) -> set[str]:
        return {path.stem for path in (self.folder / "incidents").glob("*.incident")}

    def reply(self) -> IncidentsReply:
        return Decoder(IncidentsReply)(encode(self.service.on_incidents(Nothing())))


HEAD = RecordingHead(
    swarm="meadow",
    clock=clock_id(),
    machine="",
    identity=RobotIdentity(
        robot="r1", platform=load_platform("burger"), setup=RobotSetup(driver="d"), seed=1,
        instance="i1",
    ),
)  # fmt: skip


RUNNING = Beacon(
    robot="r2", instance=bytes(6), sequence=1, wire=1, state=STATES.index(State.RUNNING), revision=1
)


async def test_what_a_killed_daemon_left_outlives_a_second_kill_at_any_time(tmp_path: Path) -> None:
    first = Service(tmp_path)
    first.keep(frames.EventEntry(boottime(), "x"))
    first.die()
    second = Service(tmp_path)  # killed before any task of it ran
    assert len(second.files()) == 1
    second.die()


async def test_an_incident_whose_file_was_being_written_at_the_kill_is_written(
    tmp_path: Path,
) -> None:
    first, now, told = Service(tmp_path), boottime(), incident("aaaaaaaaaaaa")
    entry = frames.TextEntry(now - 12.0, "/incident", msgspec.json.encode(told))
    first.keep(frames.EventEntry(now - 20.0, "x"), entry, frames.EventEntry(now, "y"))
    first.die()
    assert told.id in Service(tmp_path).files()


async def test_what_a_killed_daemon_left_waits_for_room_on_the_disk(tmp_path: Path) -> None:
    first = Service(tmp_path)
    first.keep(frames.EventEntry(boottime(), "x"))
    first.die()
    first.folder.write_text("in the way")
    full = Service(tmp_path)
    assert "not on disk" in full.reply().fault
    full.service.close(has_crashed=False)
    first.folder.unlink()
    assert len(Service(tmp_path).files()) == 1


async def test_an_incident_right_before_a_kill_is_written(tmp_path: Path) -> None:
    first = Service(tmp_path)
    first.keep(frames.EventEntry(boottime(), "x"))
    first.mark("f" * 12)
    first.die()
    assert "f" * 12 in Service(tmp_path).files()


async def test_a_ring_with_an_incident_of_another_form_ends_no_start(tmp_path: Path) -> None:
    first = Service(tmp_path)
    first.keep(frames.TextEntry(boottime(), "/incident", b'{"id": 3}'))
    first.die()
    assert Service(tmp_path).recorder.black_box.ring is not None


async def test_an_error_in_the_black_box_ends_no_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RecordingHead, "texts", lambda head: {"a": 1 / 0})
    assert "division" in Service(tmp_path).reply().fault


@pytest.mark.parametrize("name", ["boottime", "silent_id", "zlib.crc32"])
async def test_an_error_in_the_black_box_ends_no_daemon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    service, now = Service(tmp_path), boottime()
    service.keep(frames.EventEntry(now, "x"))
    service.mark("c" * 12)
    with monkeypatch.context() as patch:
        patch.setattr(f"swarmd.daemon.incidents.{name}", lambda *args: 1 / 0)
        service.service.on_lost(RUNNING)
        service.service.advance(now + 20.0)
        await asyncio.gather(*service.service._tasks)
    service.service.on_lost(RUNNING)
    service.service.advance(now + 30.0)
    assert "ZeroDivisionError" in service.reply().fault
    assert service.reply().kept is None


async def test_a_daemon_that_is_killed_again_and_again_begins_one_incident_in_ten_seconds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = boottime()
    monkeypatch.setattr("swarmd.daemon.incidents.boottime", lambda: now)
    for number in range(4):
        service = Service(tmp_path)
        service.recorder.black_box.ring.revision = number  # type: ignore[union-attr]
        service.keep(frames.EventEntry(now, "x"))
        service.die()
    assert len(Service(tmp_path).files()) == 1


async def test_lost_peers_do_not_use_up_the_incidents_of_the_robot_itself(tmp_path: Path) -> None:
    service = Service(tmp_path)
    lost = Found(IncidentKind.SILENT, "not heard", "b" * 12)
    assert service.service._begin(lost, robot="r2")
    service.mark("c" * 12)
    service.mark("d" * 12)
    assert [one.code for one in service.answers] == [Code.APPLIED, Code.REFUSED]


@pytest.mark.parametrize("gap", [0.05, 6.0])
async def test_a_daemon_that_stood_still_tells_of_no_lost_peers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gap: float
) -> None:
    service, now = Service(tmp_path), boottime()
    monkeypatch.setattr("swarmd.daemon.incidents.boottime", lambda: now)
    service.service.advance(now - gap)
    service.service.advance(now)  # a tick may come before the look at the network
    service.service.on_lost(RUNNING)
    assert bool(service.events) is (gap < 1.0)


async def test_tales_of_many_robots_end_no_incident_whose_file_is_due(tmp_path: Path) -> None:
    service = Service(tmp_path)
    service.keep(frames.EventEntry(boottime(), "x"))
    service.mark("f" * 12)
    service.tell(*(incident(f"{n:012x}", f"r{n}") for n in range(2, 60)))
    service.service.close(has_crashed=False)
    assert "f" * 12 in service.files()
    assert len(service.files()) <= MAX_KEPT
    assert len(service.reply().incidents) == len(service.files())


async def test_a_file_of_an_earlier_boot_without_a_set_clock_has_no_age(tmp_path: Path) -> None:
    service = Service(tmp_path)
    for id, wall in (("a" * 12, 0.0), ("b" * 12, time.time() - 500.0)):
        told = msgspec.structs.replace(incident(id), wall=wall)
        head = IncidentHead(
            incident=told, at=5.0, clock="earlier", begin=1.0, end=9.0, size=0, about={},
            boot=4.0, wall=60.0,
        )  # fmt: skip
        service.service._note_kept(head, 10, 0)
    ages = {one.incident.id: one.age for one in service.reply().incidents}
    assert ages["a" * 12] is None
    assert ages["b" * 12] == pytest.approx(500.0, abs=30.0)


async def test_a_ring_that_ended_by_itself_tells_the_next_daemon_of_no_crash(
    tmp_path: Path,
) -> None:
    service = Service(tmp_path)
    service.keep(frames.EventEntry(boottime(), "x"))
    service.recorder.black_box.end("no room")
    service.mark("c" * 12)
    assert "no room" in service.answers[0].text
    service.service.close(has_crashed=False)
    assert Service(tmp_path).files() == set()


async def test_a_stop_loses_no_file_that_is_being_written(tmp_path: Path) -> None:
    service = Service(tmp_path)
    service.keep(frames.EventEntry(boottime(), "x"))
    service.mark("f" * 12)
    service.service.advance(boottime() + 20.0)
    service.service.close(has_crashed=False)
    await asyncio.gather(*service.service._tasks)
    assert service.files() == {"f" * 12}


async def test_the_words_of_a_tale_forge_no_line_of_the_log(tmp_path: Path) -> None:
    service = Service(tmp_path)
    told = msgspec.structs.replace(incident("a" * 12, "r2"), text="x\n\x1b]0;y\x07")
    service.tell(told)
    assert service.events
    assert all(text.isprintable() for text in service.events)


async def test_a_file_that_no_robot_wrote_delays_no_start_and_is_not_listed(
    tmp_path: Path,
) -> None:
    first = Service(tmp_path)
    first.keep(frames.EventEntry(boottime(), "x"))
    first.mark("a" * 12)
    first.service.close(has_crashed=False)
    folder = first.folder / "incidents"
    whole = (folder / f"{'a' * 12}.incident").read_bytes()
    os.mkfifo(folder / f"{'b' * 12}.incident")  # to open it would wait for a writer
    (folder / f"{'c' * 12}.incident").write_bytes(whole[:-9])  # a copy, cut off
    (one,) = Service(tmp_path).reply().incidents
    assert (one.incident.id, one.size) == ("a" * 12, len(whole))
    query = FetchQuery(file=f"{'b' * 12}.incident", offset=0, length=9)
    assert "regular" in first.service.on_incident(query)().text


async def test_more_files_than_a_list_takes_hide_none_of_the_newest(tmp_path: Path) -> None:
    service = Service(tmp_path)
    head = IncidentHead(
        incident=incident("0" * 12), at=5.0, clock=clock_id(), begin=1.0, end=9.0, size=0, about={},
        boot=4.0, wall=60.0,
    )  # fmt: skip
    for number in range(70):
        told = msgspec.structs.replace(head.incident, id=f"{number:012x}")
        service.service._note_kept(msgspec.structs.replace(head, incident=told), 10, 0)
    assert service.reply().incidents[-1].incident.id == f"{69:012x}"


async def test_a_pipe_in_the_place_of_the_ring_delays_no_start(tmp_path: Path) -> None:
    first = Service(tmp_path)
    first.service.close(has_crashed=False)
    os.mkfifo(tmp_path / "memory" / first.service._ring_name)
    assert Service(tmp_path).reply().fault


async def test_an_incident_before_a_suspend_is_written_after_it(tmp_path: Path) -> None:
    service, now = Service(tmp_path), boottime()
    service.keep(frames.EventEntry(now, "x"))
    service.mark("a" * 12)
    service.service.advance(now + 3600.0)  # the clock counts while the machine is suspended
    await asyncio.gather(*service.service._tasks)
    assert service.files() == {"a" * 12}


async def test_what_a_daemon_of_another_version_left_is_written(tmp_path: Path) -> None:
    first = Service(tmp_path)
    first.keep(frames.EventEntry(boottime(), "x"))
    first.die()
    path = tmp_path / "memory" / first.service._ring_name
    key = b"\xa4head"
    content = path.read_bytes()
    at = content.rindex(key) + len(key) + 3  # after the size of the text
    path.write_bytes(content[:at] + b"?" * 9 + content[at + 9 :])
    assert len(Service(tmp_path).files()) == 1


async def test_what_was_left_before_a_reboot_is_no_incident_of_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Service(tmp_path)  # its folder may be on a disk
    first.keep(frames.EventEntry(boottime() + 9e4, "x"))
    first.die()
    monkeypatch.setattr("swarmd.daemon.incidents.clock_id", lambda: "later")
    second = Service(tmp_path)
    assert second.files() == set()
    assert second.service.digest == b""


async def test_robots_of_two_working_folders_have_rings_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = set()
    for place in (tmp_path / "a", tmp_path / "b"):
        place.mkdir()
        monkeypatch.chdir(place)
        service = IncidentService(
            "r1", Path("state"), BlackboxSection(), recorder=MagicMock(), puller=MagicMock(),
            head=lambda: HEAD, identity=lambda: None, is_member=lambda name: True,
            on_event=lambda text: None,
        )  # fmt: skip
        names.add(service._ring_name)
    assert len(names) == 2


# Who says so


async def test_a_mark_that_a_peer_told_first_is_noted_as_the_robot_s_own(tmp_path: Path) -> None:
    service, id = Service(tmp_path), "a" * 12
    service.keep(frames.EventEntry(boottime(), "x"))
    service.tell(incident(id, "r2", IncidentKind.MARK), giver="r2")
    service.mark(id)
    assert service.answers[-1].code is Code.APPLIED
    await service.advance(20.0)
    (one,) = service.reply().incidents
    assert (one.incident.robot, one.incident.by, one.operator) == ("r1", "r1", "anna")
    head = service.heads()[id]
    assert (head.incident.robot, head.operator) == ("r1", "anna")
    (told,) = msgspec.msgpack.decode(service.service._list(), type=list[ToldIncident])
    assert msgspec.msgpack.decode(told.content, type=Incident).by == "r1"


async def test_a_mark_whose_file_is_written_with_the_words_of_a_peer_gets_its_own(
    tmp_path: Path,
) -> None:
    service, id = Service(tmp_path), "a" * 12
    service.keep(frames.EventEntry(boottime(), "x"))
    service.tell(incident(id, "r2", IncidentKind.MARK), giver="r2")
    await service.advance(20.0)
    before = service.reply().incidents[0]
    assert before.incident.robot == "r2"
    service.mark(id)
    await service.threads()
    (one,) = service.reply().incidents
    assert (one.incident.robot, one.incident.by, one.operator) == ("r1", "r1", "anna")
    path = service.folder / "incidents" / one.file
    assert (one.size, one.crc) == (path.stat().st_size, zlib.crc32(path.read_bytes()))
    head, left = read(path)
    assert head.incident.robot == "r1"
    assert entries_of(left), "its frames are as they were"


async def test_an_estop_that_a_peer_told_first_has_the_robot_s_own_words(tmp_path: Path) -> None:
    service = Service(tmp_path)
    service.keep(frames.EventEntry(boottime(), "x"))
    lie = msgspec.structs.replace(incident("a" * 12, "r2", IncidentKind.FAULT), text="all is well")
    service.tell(lie, giver="r2")
    service.service._begin(Found(IncidentKind.ESTOP, "emergency stop by anna", "a" * 12))
    (one,) = service.reply().incidents
    assert (one.incident.text, one.incident.by) == ("emergency stop by anna", "r1")


async def test_a_mark_with_the_id_of_another_incident_replaces_no_words(tmp_path: Path) -> None:
    service = Service(tmp_path)
    service.keep(frames.EventEntry(boottime(), "x"))
    service.tell(incident("a" * 12, "r2", IncidentKind.HAZARD), giver="r2")
    service.mark("a" * 12)
    (one,) = service.reply().incidents
    assert (one.incident.by, one.incident.kind) == ("r2", IncidentKind.HAZARD)


async def test_the_age_that_the_teller_states_replaces_that_of_a_peer(tmp_path: Path) -> None:
    service, told = Service(tmp_path), incident("a" * 12, "r2", IncidentKind.HAZARD)
    service.keep(frames.EventEntry(boottime(), "x"))
    service.tell(told, giver="r3", age=90.0)
    (one,) = service.reply().incidents
    assert one.source == "r3"
    service.tell(msgspec.structs.replace(told, text="a lie"), giver="r2", age=50.0)
    service.tell(told, giver="r4", age=50.0)
    assert service.reply().incidents[0].source == "r3"
    service.tell(told, giver="r2", age=4.0)
    (one,) = service.reply().incidents
    assert one.source == ""
    assert one.age == pytest.approx(4.0, abs=3.0)
    await service.advance(20.0)
    head = service.heads()["a" * 12]
    assert head.source == ""
    service.tell(told, giver="r3", age=90.0)
    assert service.reply().incidents[0].age < 60.0  # type: ignore[operator]


async def test_tales_at_second_hand_use_up_nothing_of_the_robot_that_they_are_of(
    tmp_path: Path,
) -> None:
    service = Service(tmp_path)
    service.tell(*(incident(f"{n:012x}", "r2", IncidentKind.HAZARD) for n in range(9)), giver="r3")
    assert len(service.reply().incidents) == 1, "one in ten seconds"
    assert service.reply().incidents[0].source == "r3"
    service.tell(incident("a" * 12, "r2", IncidentKind.HAZARD), giver="r2")
    assert {one.incident.id for one in service.reply().incidents} >= {"a" * 12}


async def test_a_flood_of_a_robot_keeps_no_tale_of_another_one_out(tmp_path: Path) -> None:
    service = Service(tmp_path)
    kinds = list(IncidentKind)
    for number in range(60):  # beyond its rate, as a list that it has filled
        told = _Told(incident(f"{number:012x}", "wolf", kinds[number % 9]), boottime())
        service.service._tell(told)
    service.tell(incident("a" * 12, "r2"), giver="r2")
    service.mark("b" * 12)
    assert {"a" * 12, "b" * 12} <= service.service._told.keys()
    assert len(service.service._told) <= 32


def marked(
    keys: SwarmKeys, id: str = "a" * 12, text: str = "anna: it fell", **more: Any
) -> Incident:
    """A mark of r1 with the signature of anna."""
    fields: dict[str, Any] = {"marked": time.time(), **more}
    part = mark_part(id, "anna", "anna: it fell", fields["marked"])
    signature = sign(load_private_key(keys["anna"].key), Purpose.MARK, part)
    return Incident(
        id=id, robot="r1", kind=IncidentKind.MARK, text=text, by="r1", operator="anna",
        signature=signature, **fields,
    )  # fmt: skip


def operators_of(keys: SwarmKeys, *incidents: Incident) -> list[str]:
    """The operators that r3 takes these for, as r1 tells them."""
    found = _checked(listed(*(_signed(one, keys["r1"]) for one in incidents)), keys["r3"], ())
    assert not isinstance(found, str), found
    assert len(found) == len(incidents), "they are kept as words of r1"
    return [one.operator for one in found]


def test_the_mark_of_an_operator_is_known_by_the_signature(keys: SwarmKeys) -> None:
    true = marked(keys)
    assert operators_of(keys, true) == ["anna"]
    old = marked(keys, marked=time.time() - 7200.0)
    false = [
        msgspec.structs.replace(true, text="anna: all is well"),
        msgspec.structs.replace(true, id="b" * 12),
        msgspec.structs.replace(true, operator="bob"),
        msgspec.structs.replace(true, operator="r1"),
        msgspec.structs.replace(true, operator=""),
        msgspec.structs.replace(true, kind=IncidentKind.HAZARD),
        msgspec.structs.replace(true, marked=true.marked + 1.0),
        msgspec.structs.replace(true, signature=b""),
        msgspec.structs.replace(true, signature=b"\1" * 64),
        old,
    ]
    assert operators_of(keys, *false) == [""] * len(false)
    # A clock that was never set tells nothing of the age.
    assert operators_of(keys, marked(keys, marked=0.0)) == ["anna"]


async def test_a_mark_as_swarmctl_sends_it_is_that_of_the_operator_also_at_second_hand(
    tmp_path: Path, keys: SwarmKeys
) -> None:
    service, id = Service(tmp_path), "a" * 12
    service.identity = keys["r1"]
    service.keep(frames.EventEntry(boottime(), "x"))
    operator: Any = SimpleNamespace(name="anna", identity=keys["anna"])
    fields = mark_fields(operator, "it fell " * 30, id)
    request = encode(MarkRequest(id="m", operator="anna", targets={"r1": None}, **fields))
    service.service.on_mark(Decoder(MarkRequest)(request), service.answer)
    await service.threads()
    found = _checked(service.service._list(), keys["r3"], ())
    assert not isinstance(found, str), found
    assert [(one.incident.by, one.operator) for one in found] == [("r1", "anna")]
    assert mark_fields(SimpleNamespace(name="anna", identity=None), "w", id).keys() == {  # type: ignore[arg-type]
        *("words", "incident"),
    }


def test_a_mark_with_the_longest_words_and_names_fits_into_what_is_told(keys: SwarmKeys) -> None:
    name = "x" * 63
    told = Incident(
        id="a" * 12, robot=name, kind=IncidentKind.ASSUMPTION, text="\U0001f600" * 300, by=name,
        wall=1.7e9, operator="\U0001f600" * 128, marked=1.7e9, signature=bytes(64),
    )  # fmt: skip
    checked = _checked(listed(_signed(told, None)), None, ())
    assert not isinstance(checked, str)
    (found,) = checked
    assert found.incident.id == "a" * 12


class OldIncident(msgspec.Struct, frozen=True, kw_only=True):
    """An incident as version e0319367 reads it."""

    id: str
    robot: str
    kind: str
    text: str
    by: str
    wall: float = 0.0


def test_an_older_version_reads_what_is_told_and_this_one_reads_its(keys: SwarmKeys) -> None:
    told = _signed(marked(keys), keys["r1"])
    assert told is not None
    old = msgspec.msgpack.decode(told.content, type=OldIncident)
    assert (old.id, old.text, old.by) == ("a" * 12, "anna: it fell", "r1")
    content = msgspec.msgpack.encode(old)
    key = load_private_key(keys["r1"].key)
    by_old = msgspec.structs.replace(
        told, content=content, signature=sign(key, Purpose.INCIDENT, content)
    )
    checked = _checked(listed(by_old), keys["r3"], ())
    assert not isinstance(checked, str)
    (found,) = checked
    assert (found.incident.text, found.operator) == ("anna: it fell", "")


# After a crash, and a disk that refuses


async def test_a_daemon_that_crashes_again_within_seconds_tells_its_peers_of_the_first_crash(
    tmp_path: Path,
) -> None:
    first = Service(tmp_path)
    first.keep(frames.EventEntry(boottime(), "x"))
    first.die()
    second = Service(tmp_path)  # it finds the death, and is killed before a peer has asked
    (death,) = second.files()
    second.keep(frames.EventEntry(boottime(), "x"))
    second.die()
    third = Service(tmp_path)
    await third.threads()
    told = msgspec.msgpack.decode(third.service._list(), type=list[ToldIncident])
    found = [msgspec.msgpack.decode(one.content, type=Incident).id for one in told]
    assert death in found
    assert third.service.digest


async def test_only_own_incidents_of_the_last_minutes_are_told_again(tmp_path: Path) -> None:
    first = Service(tmp_path)
    first.keep(frames.EventEntry(boottime(), "x"))
    first.tell(incident("b" * 12, "r2"), giver="r2")
    first.mark("a" * 12)
    first.service._told["a" * 12].at -= 200.0
    first.service.close(has_crashed=False)
    assert Service(tmp_path).service.digest == b""


async def test_a_file_that_the_disk_refused_is_written_once_there_is_room(tmp_path: Path) -> None:
    service, id = Service(tmp_path), "c" * 12
    service.keep(frames.EventEntry(boottime(), "x"))
    service.mark(id)
    service.folder.write_text("in the way")
    await service.advance(20.0)
    assert "not on disk" in service.reply().fault
    (one,) = service.reply().incidents
    assert (one.incident.id, one.size, bool(one.missing)) == (id, 0, True)
    await service.advance(40.0)
    assert sum("not on disk" in text for text in service.events) == 1, "said once"
    service.folder.unlink()
    await service.advance(1.0)
    assert service.files() == set(), "not at each tick"
    await service.advance(60.0)
    assert service.files() == {id}
    (one,) = service.reply().incidents
    assert (one.size > 0, service.reply().fault) == (True, "")


async def test_a_file_that_the_disk_refused_is_written_at_the_end(tmp_path: Path) -> None:
    service = Service(tmp_path)
    service.keep(frames.EventEntry(boottime(), "x"))
    service.mark("c" * 12)
    service.folder.write_text("in the way")
    await service.advance(20.0)
    service.folder.unlink()
    service.service.close(has_crashed=False)
    assert service.files() == {"c" * 12}


async def test_files_that_wait_for_the_disk_take_a_bounded_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = Service(tmp_path)
    service.keep(frames.EventEntry(boottime(), "x"))
    service.folder.write_text("in the way")
    service.tell(incident("a" * 12, "r2"), giver="r2")
    service.tell(incident("b" * 12, "r3"), giver="r3")
    await service.advance(20.0)
    size = len(service.service._waiting["a" * 12].data)
    monkeypatch.setattr("swarmd.daemon.incidents.MAX_WAITING", 2 * size - 1)
    await service.advance(20.0)
    assert list(service.service._waiting) == ["b" * 12]
    assert any("lost" in text and "a" * 12 in text for text in service.events)


async def test_the_black_box_begins_once_what_a_killed_daemon_left_is_on_disk(
    tmp_path: Path,
) -> None:
    first = Service(tmp_path)
    first.keep(frames.EventEntry(boottime(), "x"))
    first.die()
    first.folder.write_text("in the way")
    second = Service(tmp_path)
    assert second.recorder.black_box.ring is None
    first.folder.unlink()
    await second.advance(20.0)
    assert len(second.files()) == 1
    assert second.recorder.black_box.ring is not None
    assert second.reply().fault == ""


def lie(id: str) -> Incident:
    """A mark that the robot r2 tells in an operator's name."""
    return msgspec.structs.replace(incident(id, "r2", IncidentKind.MARK), text="anna: all is well")


async def test_a_mark_that_a_peer_tells_first_hides_no_stop_of_the_robot_itself(
    tmp_path: Path,
) -> None:
    service = Service(tmp_path)
    service.keep(frames.EventEntry(boottime(), "x"))
    service.tell(lie("a" * 12), giver="r2")
    service.service._begin(Found(IncidentKind.ESTOP, "emergency stop by anna", "a" * 12))
    (one,) = service.reply().incidents
    assert (one.incident.text, one.incident.by) == ("emergency stop by anna", "r1")


async def test_a_mark_that_a_peer_tells_first_hides_no_death_of_another_robot(
    tmp_path: Path,
) -> None:
    service = Service(tmp_path)
    service.keep(frames.EventEntry(boottime(), "x"))
    dead = msgspec.structs.replace(RUNNING, robot="r3")
    service.service.advance(boottime())
    service.tell(lie(silent_id("r3", dead.instance.hex(), dead.revision)), giver="r2")
    service.service.on_lost(dead)
    told = [
        (one.incident.robot, one.incident.kind, one.incident.by)
        for one in service.reply().incidents
    ]
    assert ("r3", IncidentKind.SILENT, "r1") in told


async def test_the_file_of_a_stop_that_was_told_before_it_came_has_the_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot comes back into reach: a peer tells the stop of 60 s ago, then the latch arrives."""
    now = boottime()
    monkeypatch.setattr("swarmd.daemon.incidents.boottime", lambda: now)
    service = Service(tmp_path)
    service.keep(frames.EventEntry(now, "x"))
    service.tell(incident("a" * 12, "r2", IncidentKind.ESTOP), giver="r2", age=60.0)
    await service.advance(0.1)
    assert service.files() == {"a" * 12}
    now += 0.5
    braked = now
    ring = service.recorder.black_box.ring
    assert ring is not None
    ring.write(frames.batch([frames.encode(frames.EventEntry(braked, "it brakes"))]))
    service.service._begin(Found(IncidentKind.ESTOP, "emergency stop by anna", "a" * 12))
    await service.threads()
    now += 20.0
    service.service.advance(now)
    await service.threads()
    head = service.heads()["a" * 12]
    assert head.incident.by == "r1"
    assert head.at == braked
    assert head.end >= braked
