"""Which files of incidents give way, whose tales count, and what a killed writer leaves."""

from __future__ import annotations

import asyncio
import os
import time
from pathlib import Path
from unittest.mock import MagicMock

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.clock import boottime, clock_id
from swarmd.core.codec import Decoder, encode
from swarmd.core.incident import Found, Incident, IncidentKind, ToldIncident
from swarmd.core.messages import Code, Reply, State
from swarmd.core.verbs import FetchQuery, IncidentsReply, KeptIncident, MarkRequest, Nothing
from swarmd.daemon.incidents import (
    MAX_BYTES,
    MAX_KEPT,
    IncidentService,
    _checked,
    _signed,
    _Told,
    to_remove,
)
from swarmd.daemon.recorder import Recorder
from swarmd.network.datagram import STATES, Beacon
from swarmd.recording import frames
from swarmd.recording.head import RecordingHead
from swarmd.recording.incident_file import IncidentHead
from swarmd.recording.ring import Ring, entries_of, memory_folder, read_left, remove_old
from swarmd.robot.setup import RobotIdentity, RobotSetup
from swarmd.settings.platforms import load_platform
from swarmd.settings.swarmfile import BlackboxSection
from tests.support.examples import examples
from tests.support.keys import SwarmKeys

MEGABYTE = 2**20


def incident(id: str, by: str = "r1", kind: str = IncidentKind.ESTOP) -> Incident:
    return Incident(id=id, robot=by, kind=kind, text="a cat", by=by)


def kept(*told: Incident, size: int = MEGABYTE) -> list[KeptIncident]:
    return [
        KeptIncident(incident=one, age=None, file=f"{one.id}.incident", size=size) for one in told
    ]


def test_a_robot_that_tells_too_much_hides_only_what_it_told() -> None:
    honest = [incident(f"h{n}", f"r{n}", IncidentKind.HAZARD) for n in range(6)]
    files = kept(*honest)
    for number in range(200):
        new = incident(f"w{number}", "wolf", IncidentKind.FAULT)
        gone = to_remove(files, new, MEGABYTE)
        files = [*(one for one in files if one.incident.id not in gone), *kept(new)]
        assert len(files) <= MAX_KEPT
    assert {one.incident.id for one in files} >= {one.id for one in honest}


def test_the_first_of_each_kind_stays_and_the_oldest_of_the_rest_goes() -> None:
    kinds = list(IncidentKind)[:4]
    files = kept(*(incident(f"i{n}", "r1", kinds[n % 4]) for n in range(MAX_KEPT)))
    assert to_remove(files, incident("new"), MEGABYTE) == ["i4"]


def test_unknown_kinds_of_a_stranger_are_not_firsts() -> None:
    files = kept(*(incident(f"i{n}", "r1", f"kind{n}") for n in range(MAX_KEPT)))
    assert to_remove(files, incident("new"), MEGABYTE) == ["i0"]


def test_marks_take_at_most_half() -> None:
    estops = [incident(f"e{n}") for n in range(5)]
    marks = [incident(f"m{n}", kind=IncidentKind.MARK) for n in range(MAX_KEPT // 2)]
    new = incident("new", kind=IncidentKind.MARK)
    assert to_remove(kept(*estops, *marks), new, MEGABYTE) == ["m0"]
    large = kept(*estops, size=1000) + kept(*marks[:1], size=MAX_BYTES // 2 - 10)
    assert to_remove(large, new, 11) == ["m0"]


def test_files_are_limited_by_their_bytes() -> None:
    files = kept(*(incident(f"i{n}") for n in range(4)), size=MAX_BYTES // 4)
    assert to_remove(files, incident("new"), MAX_BYTES // 2) == ["i1", "i2"]


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
    every=st.integers(1, 9),
)
def test_a_writer_that_dies_at_any_write_leaves_whole_frames(
    tmp_path_factory: pytest.TempPathFactory, sizes: list[int], dies_at: int, every: int
) -> None:
    path = tmp_path_factory.mktemp("ring") / "ring"
    calls = 0
    written = 0

    class Dead(BaseException):
        pass

    def pwrite(file: int, data: bytes, at: int) -> int:
        nonlocal calls
        calls += 1
        if calls == dies_at:
            _pwrite(file, data[: len(data) // 2], at)  # the kernel has copied a part
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
    times = [entry.at for entry in entries_of(left)]
    assert times == [float(n) for n in range(int(times[0]), int(times[-1]) + 1)] if times else True
    if times:
        assert times[-1] in (written, written + 1)
        assert times[0] % every == 0


def test_a_ring_that_a_process_writes_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "ring"
    made = Ring(path, {}, capacity=1000, seconds=9.0, boot=1.0, wall=2.0)
    assert read_left(path) is None
    with pytest.raises(OSError, match="unavailable"):
        Ring(path, {}, capacity=1000, seconds=9.0, boot=1.0, wall=2.0)
    made.close(keeps_file=False)
    assert not path.exists()


def test_the_folder_in_memory_is_of_this_user_alone(tmp_path: Path) -> None:
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    (tmp_path / "link").symlink_to(tmp_path)
    for name in ("open", "link"):
        with pytest.raises(OSError, match="alone"):
            memory_folder(str(tmp_path / name), {})
    made = memory_folder(None, {"RUNTIME_DIRECTORY": str(tmp_path / "run")})
    assert made.stat().st_mode & 0o777 == 0o700


def test_only_old_rings_are_removed_from_the_folder(tmp_path: Path) -> None:
    Ring(tmp_path / "ring", {}, capacity=1000, seconds=9.0, boot=1.0, wall=2.0).close()
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
        self.service = IncidentService(
            "r1", self.folder, BlackboxSection(folder=str(folder / "memory")),
            recorder=self.recorder, puller=MagicMock(), head=lambda: HEAD,
            identity=lambda: None, is_member=lambda name: True, on_event=self.events.append,
        )  # fmt: skip
        self.service.open()

    def keep(self, *entries: frames.Entry) -> None:
        """A segment of the ring."""
        ring = self.recorder.ring
        assert ring is not None
        ring.begin_segment(entries[0].at)
        ring.write(frames.batch([frames.encode(one) for one in entries]))

    def die(self) -> None:
        """Leave the ring as a daemon that is killed."""
        assert self.recorder.ring is not None
        self.recorder.ring.close()

    def tell(self, *incidents: Incident) -> None:
        told = [_Told(one, 0.0, _signed(one, None)) for one in incidents]
        self.service._on_checked("r9", boottime(), told)

    def mark(self, id: str) -> None:
        request = MarkRequest(id="m", operator="anna", targets={"r1": None}, words="w", incident=id)
        self.service.on_mark(request, self.answer)

    def answer(self, reply: Reply, *, is_stored: bool = True, is_audited: bool = True) -> None:
        self.answers.append(reply)

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
    assert Service(tmp_path).recorder.ring is not None


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
        service.recorder.ring.revision = number  # type: ignore[union-attr]
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
    service.recorder.end_ring("no room")
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
