"""`swarmctl incidents`: incidents of several robots as one list, fetched, and replayed together."""

from __future__ import annotations

import asyncio
import json
import zlib
from contextlib import closing, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import pytest
from msgspec import structs

from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import ConfigError, RequestError, SwarmError
from swarmd.core.events import NeighborsInput, PlaceInput
from swarmd.core.incident import Incident, IncidentKind
from swarmd.core.messages import Code, Reply
from swarmd.core.values import Neighbor, PeerPlace
from swarmd.core.verbs import (
    FetchQuery,
    FetchReply,
    IncidentsReply,
    KeptIncident,
    MarkRequest,
    RecordingsReply,
)
from swarmd.daemon.recording import frames
from swarmd.daemon.recording.incident_file import to_recording
from swarmd.daemon.recording.lost_member import LOST, LostMember
from swarmd.operator.cli.options import CommonOptions
from swarmd.operator.cli.swarmctl import cli, exit_code_of, run_cli
from swarmd.operator.client.operator_pool import OperatorPool
from swarmd.operator.client.swarm import Swarm
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.session import Session
from swarmd.operator.verbs.incidents import ask, command
from swarmd.operator.verbs.incidents.ask import Incidents, accounts_of, gathered
from swarmd.operator.view.commander import LiveCommander
from swarmd.operator.view.source import CommandProgress
from tests.support.incidents import ID, incident_of, keep
from tests.support.recorded_stories import Story

ROBOTS = ("tb3-01", "tb3-02")
OTHER = "01ff00000000"


def kept(by: str = "tb3-02", id: str = ID, age: float | None = 5.0, **more: Any) -> KeptIncident:
    incident = structs.replace(incident_of("tb3-02"), id=id, by=by)
    return KeptIncident(incident=incident, age=age, file=f"{id}.incident", **more)


def reply(robot: str, *some: KeptIncident, **more: Any) -> IncidentsReply:
    return IncidentsReply(robot=robot, now=9.0, clock="c", incidents=some, kept=60.0, **more)


class Robots:
    """Robots that keep the minutes of one incident, in place of a swarm."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys
        self.files: dict[str, bytes] = {}
        self.replies: dict[str, IncidentsReply] = {}
        self.missing: tuple[str, ...] = ()
        self.code = 0
        self.left = 10**6  # answers with pieces
        self.told: list[str] = []  # lines for users of Python
        monkeypatch.setattr(CommonOptions, "operator", lambda options: nullcontext(self))
        monkeypatch.setattr(command, "ask_incidents", self._incidents)
        monkeypatch.setattr(ask, "ask_incidents", self._incidents)

    def _incidents(self, session: object) -> Incidents:
        faults = {robot: one.fault for robot, one in self.replies.items() if one.fault}
        found = gathered(self.replies)
        return Incidents(found, faults, self.missing, self.code, tuple(self.replies))

    def ask(self, robot: str, name: str, payload: bytes, *, timeout: float) -> Any:
        if name == "recordings":
            return encode(RecordingsReply(robot=robot, now=1e3, clock="c", files=()))
        assert name == "incident", "which needs the right of an operator"
        if not self.left:
            return None
        self.left -= 1
        query = Decoder(FetchQuery)(payload)
        data = self.files[robot][query.offset : query.offset + query.length]
        return encode(
            FetchReply(
                robot=robot, file=query.file, offset=query.offset, size=len(self.files[robot]),
                data=data, crc=zlib.crc32(data),
            )
        )  # fmt: skip

    def __call__(self) -> Self:
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""

    def close(self) -> None:
        """Nothing is open."""

    def expect(self, names: object) -> None:
        """All are known."""

    def swarm(self) -> Any:
        """A connection from Python."""
        make: Any = self
        return closing(Swarm(OperatorPool(make), tell=self.told.append))

    def clicked(self, **fields: Any) -> list[CommandProgress]:
        """The answers to a fetch of a page."""
        told: list[CommandProgress] = []
        make: Any = self
        asyncio.run(LiveCommander(make).act("fetch", fields, told.append))
        return told

    def swarmctl(self, *words: str) -> tuple[int, str, str]:
        code = run_cli(cli, list(words), "swarmctl", exit_code_of)
        out, err = self._capsys.readouterr()
        return code, out, err

    def json(self, *words: str) -> Any:
        return json.loads(self.swarmctl(*words, "-o", "json")[1])


@pytest.fixture
def robots(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Robots:
    return Robots(monkeypatch, capsys)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What each robot keeps of one incident."""
    found = {}
    for robot in ROBOTS:
        folder = tmp_path_factory.mktemp(robot)
        story = Story(folder, robot=robot)
        story.robot.advance(1.0)
        story.run("drive", speed=0.1)
        story.recorder.begin(story.robot)
        story.robot.advance(15.0)
        story.recorder.finish()
        found[robot] = keep(story, folder, incident=incident_of("tb3-02")).read_bytes()
    return found


def keep_files(robots: Robots, files: dict[str, bytes]) -> None:
    robots.files = dict(files)
    robots.replies = {
        robot: reply(robot, kept(begin=-14.0, end=1.0, size=len(data), crc=zlib.crc32(data)))
        for robot, data in files.items()
    }


def by(robot: str, text: str, kind: str, *, had: str | None = None) -> Incident:
    """An incident in the words of a robot, which had it itself unless `had` names another one."""
    return Incident(id=ID, robot=had or robot, kind=kind, text=text, by=robot)


def keeps(incident: Incident, **more: Any) -> KeptIncident:
    more = {"age": 5.0, "size": 9, "begin": -60.0, "end": 10.0, **more}
    return KeptIncident(incident=incident, file=f"{ID}.incident", **more)


def test_an_incident_has_one_row_with_who_keeps_it_and_the_newest_is_the_last(
    robots: Robots,
) -> None:
    early = kept(id=OTHER, age=500.0, begin=-60.0, end=10.0, size=420_000)
    late = kept(missing="the daemon began 12 s before", size=1)
    robots.replies = {"tb3-01": reply("tb3-01", early, late), "tb3-02": reply("tb3-02", kept())}
    robots.missing, robots.code = ("tb3-03",), 3
    code, out, err = robots.swarmctl("incidents")
    rows = [line.split("  ")[0] for line in out.splitlines()]
    assert rows[1:] == [OTHER, ID, "2 incidents"]
    column = out.splitlines()[0].index("KEPT BY")
    assert out.splitlines()[1][column:].startswith("1 of 2, not tb3-02")
    assert out.splitlines()[2][column:].startswith("1 of 2, 1 awaited")
    assert code == 3
    assert "tb3-03" in err
    found = robots.json("incident")  # the same verb
    assert [one["id"] for one in found["incidents"]] == [OTHER, ID]
    assert [one["robot"] for one in found["incidents"][1]["kept"]] == ["tb3-01", "tb3-02"]
    assert found["incidents"][1]["kept"][0]["missing"] == "the daemon began 12 s before"
    assert (found["kind"], found["missing"]) == ("Incidents", ["tb3-03"])
    # The keys of earlier versions.
    assert found["incidents"][0].keys() >= {
        *("id", "robot", "kind", "text", "by", "wall", "robots", "age", "kept"),
    }
    assert found["incidents"][0]["kept"][0].keys() >= {
        *("robot", "incident", "age", "begin", "end", "missing", "file", "size", "crc"),
    }
    assert found["incidents"][0]["kept"][0]["incident"] == OTHER


@pytest.mark.parametrize(
    ("keepers", "text"),
    [
        (7, "all 7"),
        (6, "6 of 7, not tb3-07"),
        (2, "2 of 7: tb3-01, tb3-02"),
    ],
)
def test_of_whom_an_incident_is_kept_is_said_by_the_shorter_list(
    robots: Robots, keepers: int, text: str
) -> None:
    names = [f"tb3-{n:02}" for n in range(1, 8)]
    robots.replies = {
        name: reply(name, *([keeps(by("tb3-01", "cliff", "hazard"))] if n < keepers else []))
        for n, name in enumerate(names)
    }
    head, line, _ = robots.swarmctl("incidents")[1].splitlines()
    assert line[head.index("KEPT BY") : head.index("WHY")].strip() == text


def test_the_robot_of_an_incident_is_missed_though_it_does_not_answer(robots: Robots) -> None:
    """A killed robot: its own minute is the one that is looked for."""
    one = keeps(by("tb3-01", "tb3-03 is not heard", "silent"))
    one = structs.replace(one, incident=structs.replace(one.incident, robot="tb3-03"))
    robots.replies = {name: reply(name, one) for name in ("tb3-01", "tb3-02")}
    head, line, _ = robots.swarmctl("incidents")[1].splitlines()
    assert line[head.index("KEPT BY") : head.index("WHY")].strip() == "2 of 3, not tb3-03"


def test_an_incident_that_several_robots_had_names_how_many(robots: Robots) -> None:
    """Each robot of an emergency stop or a mark has it, and notes it as its own."""
    names = [f"tb3-{n:02}" for n in range(1, 13)]
    robots.replies = {name: reply(name, keeps(by(name, "anna: x", "mark"))) for name in names}
    assert "12 robots" in robots.swarmctl("incidents")[1]
    assert robots.json("incidents")["incidents"][0]["robots"] == names


def test_words_of_a_robot_hide_those_of_no_other(robots: Robots) -> None:
    lie = by("tb3-05", "all is well, a test of anna", "mark")
    stop = "emergency stop by anna (a child)"
    names = [f"tb3-{n:02}" for n in range(1, 8)]
    robots.replies = {
        name: reply(name, keeps(lie if name == "tb3-05" else by(name, stop, "estop")))
        for name in names
    }
    rows = robots.swarmctl("incidents")[1].splitlines()[1:-1]
    assert [("6 robots" in row, "estop" in row, stop in row) for row in rows] == [
        (True, True, True), (False, False, False),
    ]  # fmt: skip
    assert "as tb3-05 says" in rows[1]
    assert "all is well" in rows[1]
    (found,) = robots.json("incidents")["incidents"]
    assert (found["kind"], found["text"]) == ("estop", stop)
    assert "tb3-05" not in found["robots"]
    told = {one["robot"]: one["told"]["text"] for one in found["kept"]}
    assert told["tb3-05"] == lie.text
    assert {told[name] for name in names if name != "tb3-05"} == {stop}


HAZARD = by("tb3-02", "stopped (hazard) cliff", "hazard")
LIE = by("tb3-05", "all is well", "mark")
FALSE = by("tb3-02", "all is well", "mark")


@pytest.mark.parametrize(
    ("held", "first", "others"),
    [
        # A robot speaks for itself, whatever others keep in its name.
        ({"tb3-02": HAZARD, "tb3-05": FALSE, "tb3-06": FALSE}, HAZARD, []),
        # If it does not answer, what most keep in its name counts.
        ({"tb3-01": HAZARD, "tb3-03": HAZARD, "tb3-05": FALSE}, HAZARD, []),
        # One teller each: first what most robots keep.
        ({"tb3-01": HAZARD, "tb3-03": HAZARD, "tb3-05": LIE}, HAZARD, [LIE]),
        ({"tb3-02": HAZARD, "tb3-03": HAZARD, "tb3-05": LIE}, HAZARD, [LIE]),
        # Witnesses that found a robot silent do not contradict what it says itself.
        (
            {
                "tb3-01": by("tb3-01", "not heard", "silent", had="tb3-02"),
                "tb3-03": by("tb3-03", "not heard", "silent", had="tb3-02"),
                "tb3-02": by("tb3-02", "stopped (loop_stalled)", "loop_stalled"),
            },
            by("tb3-02", "stopped (loop_stalled)", "loop_stalled"),
            [],
        ),
        # But a robot that was silent does not make it an incident of another kind.
        (
            {
                "tb3-01": by("tb3-01", "not heard", "silent", had="tb3-05"),
                "tb3-03": by("tb3-03", "not heard", "silent", had="tb3-05"),
                "tb3-05": LIE,
            },
            by("tb3-01", "not heard", "silent", had="tb3-05"),
            [LIE],
        ),
    ],
)
def test_what_most_say_comes_first_and_a_contradiction_is_a_row_of_its_own(
    held: dict[str, Incident], first: Incident, others: list[Incident]
) -> None:
    accounts = accounts_of(held)
    assert [one.incident for one in accounts] == [first, *others]


@pytest.mark.parametrize(
    ("words", "ids"),
    [
        (("tb3-02",), [ID]),
        (("tb3-0[12]",), [OTHER, ID]),
        ((OTHER[:4],), [OTHER]),
        (("tb3-02", OTHER[:4]), [OTHER, ID]),
        (("0",), [OTHER, ID]),
        (("show", "tb3-01"), [OTHER]),
    ],
)
def test_words_choose_incidents_by_robot_or_id(
    robots: Robots, words: tuple[str, ...], ids: list[str]
) -> None:
    other = structs.replace(by("tb3-01", "x", "fault"), id=OTHER)
    robots.replies = {
        "tb3-01": reply("tb3-01", keeps(other, age=99.0), keeps(HAZARD)),
        "tb3-02": reply("tb3-02", keeps(HAZARD)),
    }
    found = robots.json("incidents", *words)
    assert [one["id"] for one in found["incidents"]] == ids


def test_an_id_shows_what_each_robot_keeps_with_its_own_words(robots: Robots) -> None:
    robots.replies = {
        "tb3-01": reply("tb3-01", keeps(HAZARD, source="tb3-03", missing="nothing before -9 s")),
        "tb3-02": reply("tb3-02", keeps(HAZARD, size=420_000)),
        "tb3-05": reply("tb3-05", keeps(LIE, size=0, begin=None, end=None)),
    }
    code, out, _ = robots.swarmctl("incidents", ID[:3])
    lines = out.splitlines()
    assert code == 0
    assert lines[0].startswith(f"{ID} hazard of tb3-02")
    assert "as tb3-05 says: all is well" in lines[1]
    rows = {line.split()[0]: line for line in lines[3:]}
    assert rows.keys() == {"tb3-01", "tb3-02", "tb3-05"}
    assert "tb3-02 through tb3-03" in rows["tb3-01"]
    assert "nothing before -9 s" in rows["tb3-01"]
    assert {"-60 to +10" in rows["tb3-02"], "0.42 MB" in rows["tb3-02"]} == {True}
    assert "awaited" in rows["tb3-05"]
    assert "all is well" in rows["tb3-05"]


@pytest.mark.parametrize("word", ["tb3-09", "fecth", "ffff"])
def test_a_word_that_names_nothing_is_refused_in_one_line(robots: Robots, word: str) -> None:
    robots.replies = {"tb3-01": reply("tb3-01", kept())}
    code, out, err = robots.swarmctl("incidents", word)
    assert (code, out, word in err, err.count("\n")) == (4, "", True, 1)


def test_the_robot_that_told_an_incident_first_describes_it() -> None:
    lie = structs.replace(kept(age=None), incident=structs.replace(kept().incident, text="a lie"))
    replies = {"tb3-01": reply("tb3-01", lie), "tb3-02": reply("tb3-02", kept(age=7.0))}
    (one,) = gathered(replies)
    assert (one.incident.text, one.age) == ("a chair fell", 7.0)


def test_the_robot_that_had_an_incident_describes_it() -> None:
    silent = structs.replace(kept().incident, text="not heard any more", by="tb3-01")
    died = structs.replace(kept().incident, text="its daemon died")
    replies = {
        "tb3-01": reply("tb3-01", structs.replace(kept(age=9.0), incident=silent)),
        "tb3-02": reply("tb3-02", structs.replace(kept(age=8.0), incident=died)),
    }
    (one,) = gathered(replies)
    assert (one.incident.text, one.age) == ("its daemon died", 8.0)


def test_a_fetched_incident_is_replayed_as_one_swarm(
    robots: Robots, files: dict[str, bytes], tmp_path: Path
) -> None:
    keep_files(robots, files)
    code, out, _ = robots.swarmctl("incidents", "fetch", ID[:4], "-d", str(tmp_path))
    assert code == 0
    assert out.count("whole") == 2
    for robot, data in files.items():
        assert (tmp_path / robot / f"{ID}.incident").read_bytes() == data
        assert (tmp_path / robot / f"{ID}-00001.mcap").exists()
    assert (tmp_path / "clocks.jsonl").read_bytes().count(b"\n") == 2
    code, out, _ = robots.swarmctl("replay", str(tmp_path), "-o", "json")
    found = json.loads(out)
    assert (code, found["is_equal"]) == (0, True)
    assert [row["robot"] for row in found["robots"]] == list(ROBOTS)
    assert all(row["safe"]["count"] > 100 for row in found["robots"])


def test_why_names_the_incident_first_and_then_the_decisions_with_their_bound(
    robots: Robots, files: dict[str, bytes], tmp_path: Path
) -> None:
    keep_files(robots, files)
    robots.swarmctl("incidents", "fetch", ID, "-d", str(tmp_path))
    code, out, _ = robots.swarmctl("replay", str(tmp_path), "--why", "tb3-01", "-v")
    lines = out.splitlines()
    assert code == 0
    assert lines[0].startswith(f"incident {ID} of tb3-02 at 13.950 s: mark: a chair fell")
    assert "tb3-01" in lines[1]
    raw = next(n for n, line in enumerate(lines) if n > 1 and line.startswith("tb3-01"))
    changed = lines[2:raw]
    assert float(changed[0].split()[0]) < 1.0, "the whole recording, from its begin on"
    assert "running" in changed[0]
    assert any(f"incident {ID}" in line and "13.950 s" in line for line in changed)
    assert len(changed) < 30, "what stays equal has no line"
    before = [line for line in lines[raw + 1 :] if line.startswith("  ")]
    times = [float(line.split()[0]) for line in before]
    assert 10.9 < times[0] <= times[-1] <= 13.95, "the last entries before it, none after it"
    assert {"odometry", "tick", "pattern"} <= {line.split()[2] for line in before}
    decided = [line for line in before if "->" in line]
    assert all("0.100 m/s" in line and "running" in line for line in decided)
    found = robots.json("replay", str(tmp_path), "--why", "tb3-01", "-v")
    assert found["why"] == lines[: raw + 1 + len(before)]
    short = robots.json("replay", str(tmp_path), "--why", "tb3-01")
    assert short["why"] == lines[:raw]


def test_a_fetch_that_was_cut_continues(
    robots: Robots, files: dict[str, bytes], tmp_path: Path
) -> None:
    keep_files(robots, files)
    robots.left = 2
    words = ("incidents", "fetch", ID, "-d", str(tmp_path))
    code, _, err = robots.swarmctl(*words)
    assert (code, "65536 bytes here" in err) == (3, True)
    robots.left = 10**6
    assert robots.swarmctl(*words)[0] == 0
    assert (tmp_path / "tb3-01" / f"{ID}.incident").read_bytes() == files["tb3-01"]


def test_a_fetch_from_python_and_from_the_page_copies_the_same(
    robots: Robots, files: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep_files(robots, files)
    robots.missing = ("tb3-03",)
    monkeypatch.chdir(tmp_path)
    assert robots.swarmctl("incidents", "fetch", ID, "-d", "typed")[0] == 3
    with robots.swarm() as swarm:
        fetched = swarm.fetch_incident(ID[:4], "asked")
    assert (fetched.exit_code, bool(fetched), fetched.missing) == (3, False, ("tb3-03",))
    assert [(one.robot, one.state) for one in fetched.files] == [(one, "whole") for one in ROBOTS]
    (answer,) = robots.clicked(incident=ID[:4])
    assert str(tmp_path / "incidents" / ID) in answer.line
    assert (answer.is_good, answer.missing) == (False, ["tb3-03"])
    for robot, data in files.items():
        for folder in ("typed", "asked", f"incidents/{ID}"):
            assert (tmp_path / folder / robot / f"{ID}.incident").read_bytes() == data
            assert (tmp_path / folder / robot / f"{ID}-00001.mcap").exists()


def test_a_fetch_of_no_incident_copies_nothing(
    robots: Robots, files: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep_files(robots, files)
    robots.replies["tb3-03"] = reply("tb3-03", kept(id=f"{ID[:4]}00000000"))
    monkeypatch.chdir(tmp_path)
    with robots.swarm() as swarm:
        with pytest.raises(RequestError) as error:
            swarm.fetch_incident("ffff")
        assert error.value.exit_code == 4
        for wrong in (ID[:4], "", None):
            with pytest.raises(ConfigError):
                swarm.fetch_incident(wrong)
        with pytest.raises(ConfigError):
            swarm.fetch_incident(ID, 7)
    for fields in ({"incident": "ffff"}, {"incident": ID[:4]}, {"incident": ""}, {}):
        (answer,) = robots.clicked(**fields)
        assert (answer.is_good, answer.is_final, answer.replies) == (False, True, [])
    assert list(tmp_path.iterdir()) == []


def test_a_fetch_that_is_cancelled_keeps_what_came(
    robots: Robots, files: dict[str, bytes], tmp_path: Path
) -> None:
    keep_files(robots, files)
    found = robots._incidents(None)
    calls = iter([False, True])
    session: Any = Session(robots, is_cancelled=lambda: next(calls))  # type: ignore[arg-type]
    with pytest.raises(SwarmError, match="cancelled"):
        ask.fetch(session, found, found.incidents[0], tmp_path)
    assert (tmp_path / "tb3-01" / f"{ID}.incident.partial").stat().st_size > 0
    assert ask.fetch(Session(robots), found, found.incidents[0], tmp_path)  # type: ignore[arg-type]


def test_a_file_that_is_none_is_named_and_the_others_are_fetched(
    robots: Robots, files: dict[str, bytes], tmp_path: Path
) -> None:
    keep_files(robots, {**files, "tb3-01": b"\x00" * 99})
    found = robots.json("incidents", "fetch", ID, "-d", str(tmp_path))
    states = {file["robot"]: file["state"] for file in found["files"]}
    assert states["tb3-02"] == "whole"
    assert states["tb3-01"] != "whole"
    assert found["missing"] == ["tb3-01"]


def test_a_robot_that_has_not_written_its_file_is_missing(
    robots: Robots, files: dict[str, bytes], tmp_path: Path
) -> None:
    keep_files(robots, files)
    robots.replies["tb3-01"] = reply("tb3-01", kept())
    code, _, err = robots.swarmctl("incidents", "fetch", ID, "-d", str(tmp_path))
    assert (code, "tb3-01" in err) == (3, True)


@pytest.mark.parametrize(("prefix", "code"), [("ff", 4), ("01", 2), ("0123", 0)])
def test_the_beginning_of_an_id_names_one_incident(
    robots: Robots, files: dict[str, bytes], tmp_path: Path, prefix: str, code: int
) -> None:
    keep_files(robots, files)
    first = robots.replies["tb3-01"]
    robots.replies["tb3-01"] = structs.replace(first, incidents=(kept(id=OTHER), *first.incidents))
    assert robots.swarmctl("incidents", "fetch", prefix, "-d", str(tmp_path))[0] == code


@pytest.mark.parametrize("words", ["", " ", "x" * 257])
def test_a_mark_without_words_or_with_too_many_is_refused(robots: Robots, words: str) -> None:
    code, _, err = robots.swarmctl("incident", "mark", words)
    assert (code, "WORDS" in err) == (2, True)
    with robots.swarm() as swarm, pytest.raises(ConfigError, match="WORDS"):
        swarm.mark(words)


def test_a_mark_tells_the_id_by_which_it_is_fetched() -> None:
    sent: list[Any] = []

    def request(kind: type, **fields: Any) -> Outcome:
        sent.append((kind, fields))
        return Outcome({"r1": Reply(id="1", robot="r1", code=Code.APPLIED)}, missing=("r2",))

    operator = SimpleNamespace(identity=None, name="anna@desk")
    targeted: Any = SimpleNamespace(operator=operator, request=request, counted=lambda one: one)
    outcome = ask.mark(targeted, "it hit the chair")
    assert (outcome.applied, outcome.missing, outcome.exit_code) == (("r1",), ("r2",), 3)
    assert sent == [(MarkRequest, {"words": "it hit the chair", "incident": outcome.incident})]


def silent_of(robot: str, by: str) -> Incident:
    return Incident(
        id=ID, robot=robot, kind=IncidentKind.SILENT, text=f"{robot} is not heard any more; it ran",
        by=by, wall=1.7e9,
    )  # fmt: skip


@pytest.fixture(scope="module")
def without_the_dead(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What robot a keeps of the death of robot b: it was heard, placed, and then declared failed.

    The incident is 3 s before the end, and b was declared failed with it.
    """
    made = tmp_path_factory.mktemp("made")
    folder = tmp_path_factory.mktemp("crash")
    story = Story(made, robot="a")
    story.robot.advance(1.0)
    story.recorder.begin(story.robot)
    story.run("drive", 4.0, speed=0.1)
    story.robot.step(NeighborsInput((Neighbor("b", 0.5, 1.25, 0.5), Neighbor("c", 0.1))))
    story.robot.step(PlaceInput(PeerPlace("b", "map", 1.5, -0.25, 0.05, 0.2)))
    story.robot.advance(2.0)
    member = LostMember(
        robot="b", state="running", platform="burger", age=5.0, received=25, lost=7,
        round_trip=0.0031, goal="goal 3 of anna: drive",
    )  # fmt: skip
    story.recorder.add(frames.TextEntry(story.robot.now, LOST, frames.as_json(member)))
    story.robot.advance(3.0)
    story.recorder.finish()
    path = keep(story, folder / "a", before=3.0, incident=silent_of("b", "a"))
    to_recording(path)
    return folder


def test_a_robot_without_a_recording_is_told_by_what_others_last_knew(
    robots: Robots, without_the_dead: Path
) -> None:
    """Killed: its minute is there after its next start only, and its peers have what they knew."""
    code, out, _ = robots.swarmctl("replay", str(without_the_dead), "--why", "b")
    lines = out.splitlines()
    assert code == 0, "the commands of a are equal"
    assert lines[0].startswith(f"incident {ID} of b at")
    assert lines[0].endswith("(told by a)")
    told = "\n".join(lines)
    assert f"swarmctl incidents fetch {ID} -d {without_the_dead}" in told
    lost = next(line for line in lines if "3.1 ms" in line)
    assert lost.split()[:3] == ["a,", "0", "ms"]
    for word in ("running", "burger", "7 of 32", "5.0 s", "goal 3 of anna: drive"):
        assert word in lost
    place = next(line for line in lines if "frame map" in line)
    assert place.split()[:3] == ["a,", "2.0", "s"], "whose words, and how old"
    assert "1.50, -0.25 m" in place
    near = next(line for line in lines if "1.25 m" in line)
    assert near.split()[:3] == ["a,", "2.0", "s"]
    assert not any(line.split()[:1] == ["c,"] for line in lines), "c has no recording"
    assert "safe" in out, "what a did is compared as ever"
    found = robots.json("replay", str(without_the_dead), "--why", "b")
    assert found["why"] == lines[: len(found["why"])]


def test_a_robot_that_no_recording_names_is_refused_with_those_that_are_here(
    robots: Robots, without_the_dead: Path
) -> None:
    code, out, err = robots.swarmctl("replay", str(without_the_dead), "--why", "tb3-09")
    assert (code, out) == (2, "")
    assert "tb3-09" in err
    assert "expected one of a" in err


def test_a_robot_that_is_only_a_neighbor_of_others_has_no_incident(
    robots: Robots, without_the_dead: Path
) -> None:
    code, out, _ = robots.swarmctl("replay", str(without_the_dead), "--why", "c")
    lines = out.splitlines()
    assert code == 0
    assert not lines[0].startswith("incident")
    assert any(line.split()[:3] == ["a,", "5.0", "s"] and "place not" in line for line in lines)
    assert not any("anna" in line for line in lines), "the goal of b is not that of c"


def test_words_of_a_foreign_recording_are_printed_in_one_line_each(
    robots: Robots, tmp_path: Path
) -> None:
    story = Story(tmp_path / "made", robot="a")
    story.robot.advance(1.0)
    story.recorder.begin(story.robot)
    story.run("drive", 1.0, speed=0.1)
    evil = LostMember(robot="b", state="x\x1b[31m\ny", goal="\r\nz")
    story.recorder.add(frames.TextEntry(story.robot.now, LOST, frames.as_json(evil)))
    story.robot.advance(1.0)
    story.recorder.finish()
    to_recording(keep(story, tmp_path / "crash" / "a", incident=silent_of("b", "a")))
    out = robots.swarmctl("replay", str(tmp_path / "crash"), "--why", "b")[1]
    assert all(line.isprintable() for line in out.splitlines())
    assert len(robots.json("replay", str(tmp_path / "crash"), "--why", "b")["why"]) == 5
