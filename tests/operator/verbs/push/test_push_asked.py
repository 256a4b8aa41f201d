"""A push from Python, from the page and by `swarmctl`: the same answers and the same refusals."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Collection, Iterable, Mapping
from contextlib import closing, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import pytest

from swarmd.core.codec import encode
from swarmd.core.errors import ConfigError, RequestError
from swarmd.core.messages import Code, Reply
from swarmd.core.pattern_manifest import MAX_CODE, PatternManifest, Signed, read_entry
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import PushedPatternReport, PushedPatternsReply, PushRequest
from swarmd.link.settings import NetworkSettings
from swarmd.operator.cli.options import CommonOptions
from swarmd.operator.cli.swarmctl import cli, exit_code_of, run_cli
from swarmd.operator.client.async_swarm import AsyncSwarm
from swarmd.operator.client.operator_pool import OperatorPool
from swarmd.operator.client.swarm import Swarm
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.verbs.push import ask
from swarmd.operator.view.commander import LiveCommander
from swarmd.operator.view.source import CommandProgress
from tests.support.statuses import make_member

CODE = b"x = 1\n" + b"#" * 70_000  # three pieces


class Robots:
    """Robots that take pushes, in place of an operator.

    `own` have a pattern of that name themselves, `silent` answer nothing, `ceasing` answer the
    first piece alone, and `raises` return to the version before when they run new code.
    """

    name, identity = "anna@laptop", None

    def __init__(
        self,
        names: Iterable[str] = ("r1", "r2", "r3", "r4"),
        *,
        own: Collection[str] = (),
        silent: Collection[str] = (),
        ceasing: Collection[str] = (),
        raises: Collection[str] = (),
    ) -> None:
        self.settings = NetworkSettings(swarm="s")
        self.notices: list[str] = []
        self.loops = SimpleNamespace(turn=lambda *_: None)
        self.names = tuple(names)
        self.own = set(own)
        self.silent = set(silent)
        self.ceasing = set(ceasing)
        self.asked: dict[str, list[int]] = {}  # by robot: the offsets of the pieces sent to it
        self.raises = set(raises)
        self.patterns: dict[str, PushedPatternReport] = {}  # by robot
        self.manifests: list[PatternManifest] = []
        self.code: dict[str, bytes] = {}

    def __call__(self) -> Self:
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""

    def close(self) -> None:
        """Nothing is open."""

    def expect(self, names: Collection[str]) -> None:
        """All are known."""

    def members(self, **_: Any) -> MembersView:
        members = {name: make_member(name, pattern="own") for name in self.names}
        return MembersView(members, answered=frozenset(self.names))

    def ask_all(self, robots: Iterable[str], name: str, *_: Any, **__: Any) -> dict[str, bytes]:
        assert name == "plugins"
        replies = {}
        for robot in set(robots) - self.silent:
            rows = (self.patterns[robot],) if robot in self.patterns else ()
            greatest = max((one.generation for one in rows), default=0)
            reply = PushedPatternsReply(robot=robot, generation=greatest, patterns=rows)
            replies[robot] = encode(reply)
        return replies

    def request(self, kind: type, epochs: Mapping[str, Any], **fields: Any) -> Outcome:
        assert kind is PushRequest
        manifest = read_entry(Signed(fields["content"], fields["signature"])).manifest
        self.manifests.append(manifest)
        replies = {robot: self._reply(robot, manifest, **fields) for robot in epochs}
        missing = tuple(sorted(name for name, one in replies.items() if one is None))
        return Outcome({name: one for name, one in replies.items() if one is not None}, missing)

    def _reply(
        self, robot: str, manifest: PatternManifest, *, offset: int, data: bytes, **_: Any
    ) -> Reply | None:
        self.asked.setdefault(robot, []).append(offset)
        if robot in self.silent or (robot in self.ceasing and offset > 0):
            return None
        if robot in self.own and not manifest.replaces:
            text = f"the robot has a pattern {manifest.name!r} of its own; see --replace"
            refusal = Refusal.NAME_TAKEN
            return Reply(id="1", robot=robot, code=Code.REFUSED, refusal=refusal, text=text)
        self.code[robot] = self.code.get(robot, b"")[:offset] + data
        if len(self.code[robot]) == manifest.size:
            digest = manifest.digest.hex()[: ask.DIGEST_LENGTH]
            is_returned = robot in self.raises
            self.patterns[robot] = PushedPatternReport(
                name=manifest.name,
                generation=manifest.generation,
                standing="returned" if is_returned else "held",
                text="1 / 0" if is_returned else "",
                digest="" if is_returned else digest,
            )
        return Reply(id="1", robot=robot, code=Code.APPLIED)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A look keeps the names of robots for completion."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "own.py"
    path.write_bytes(CODE)
    return path


def swarm_of(robots: Robots, told: list[str] | None = None) -> Any:
    make: Any = robots
    lines: list[str] = [] if told is None else told
    return closing(Swarm(OperatorPool(make), tell=lines.append))


def clicked(robots: Robots, **fields: Any) -> list[CommandProgress]:
    """The answers to a push of a page."""
    told: list[CommandProgress] = []
    make: Any = robots
    wanted = {"targets": list(robots.names), "file": "own.py", "size": len(CODE), "code": CODE}
    asyncio.run(LiveCommander(make).act("push", {**wanted, **fields}, told.append))
    return told


def test_a_push_names_who_took_it_had_it_refused_it_and_was_silent(file: Path) -> None:
    robots = Robots(own=["r3"], silent=["r4"])
    with swarm_of(robots) as swarm:
        assert swarm.push(file, "r1").taken == ("r1",)
        outcome = swarm.push(str(file), version="2.0")
    assert (outcome.taken, outcome.had) == (("r2",), ("r1",))
    assert (outcome.refused, outcome.missing) == (("r3",), ("r4",))
    assert outcome.replies["r3"].refusal is Refusal.NAME_TAKEN
    assert (outcome.exit_code, bool(outcome)) == (3, False)
    assert (outcome.pattern, outcome.digest) == ("own", ask.read_source(file).digest)
    assert robots.code["r2"] == CODE
    last = robots.manifests[-1]
    assert (last.generation, last.targets, last.version) == (2, (), "2.0")


def test_a_robot_that_is_silent_at_a_later_piece_is_missing_alone(file: Path) -> None:
    robots = Robots(["r1", "r2", "r3"], own=["r3"], ceasing=["r2"])
    with swarm_of(robots) as swarm:
        outcome = swarm.push(file)
    assert (outcome.taken, outcome.missing) == (("r1",), ("r2",))
    assert (outcome.refused, outcome.exit_code) == (("r3",), 3)
    assert outcome.replies.keys() == {"r1", "r3"}
    first, second, _ = robots.asked["r1"]
    assert robots.asked == {"r1": robots.asked["r1"], "r2": [first, second], "r3": [first]}


async def test_a_push_is_awaited(file: Path) -> None:
    make: Any = Robots()
    async with AsyncSwarm(Swarm(OperatorPool(make))) as swarm:
        outcome = await swarm.push(file, ["r1", "r3"])
    assert (outcome.taken, outcome.exit_code) == (("r1", "r3"), 0)


def test_a_canary_gets_it_first_and_the_others_only_if_it_holds_it(file: Path) -> None:
    robots = Robots()
    told: list[str] = []
    with swarm_of(robots, told) as swarm:
        outcome = swarm.push(file, canary="r2")
    assert {one.targets for one in robots.manifests[:3]} == {("r2",)}
    assert [one.generation for one in robots.manifests] == [1, 1, 1, 2, 2, 2]
    assert (outcome.taken, outcome.canary) == (("r1", "r2", "r3", "r4"), "holds it")
    assert any("plugin remove own" in line for line in told)
    failing = Robots(raises=["r1"])
    with swarm_of(failing) as swarm, pytest.raises(RequestError, match="1 / 0") as error:
        swarm.push(file, canary=1)
    assert error.value.exit_code == 3
    assert failing.code.keys() == {"r1"}
    taken = Robots(own=["r1"])
    told.clear()
    with swarm_of(taken, told) as swarm, pytest.raises(RequestError, match="1 refused"):
        swarm.push(file, canary="r1")
    assert taken.code == {}
    assert [line for line in told if line.startswith("r1: refused: ")]


def test_a_caller_that_no_longer_waits_for_a_canary_ends_the_push(file: Path) -> None:
    robots = Robots()
    session: Any = SimpleNamespace(
        timeout=None, operator=robots, tell=[].append, is_cancelled=lambda: True
    )
    source = ask.read_source(file)
    with pytest.raises(RequestError, match="nothing was sent to r2") as error:
        ask.await_canary(session, source, ["r1"], ["r2"], 90.0)
    assert "plugin remove own r1" in str(error.value)


@pytest.mark.parametrize(
    "wrong",
    [
        {"file": 7},
        {"version": 2},
        {"replace": "no"},
        {"rerun": 1},
        {"canary": 0},
        {"canary": 4},
        {"canary": True},
        {"canary": 1, "canary_time": -1.0},
        {"canary_time": 5.0},
        {"robots": []},
        {"canary": "r9"},
    ],
)
def test_a_wrong_argument_of_a_push_sends_nothing(file: Path, wrong: dict[str, Any]) -> None:
    robots = Robots()
    with swarm_of(robots) as swarm, pytest.raises((ConfigError, RequestError)):
        swarm.push(**{"file": file, **wrong})
    assert robots.manifests == []


def write(folder: Path, name: str, content: bytes) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


HOSTILE = {
    "a fault": ("own.py", b"x = 1\n\ndef broken(:\n"),
    "no text": ("own.py", b"\xff\xfe"),
    "too large": ("own.py", b"#" * (MAX_CODE + 1)),
    "capitals": ("Own Pattern.py", b""),
    "two lines": ("own\npattern.py", b""),
    "an escape": ("own\x1b[31m.py", b""),
    "another kind": ("own.yaml", b""),
    "no suffix": ("own", b""),
    "no zip": ("own.whl", b"no zip"),
    "a cut zip": ("own.whl", b"PK\x03\x04" + bytes(40)),
    "a large wheel": ("own.whl", bytes(MAX_CODE + 1)),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_file_is_refused_alike_from_all_three(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    name, content = HOSTILE[case]
    monkeypatch.chdir(tmp_path)
    path = Path(name)
    path.write_bytes(content)
    robots = Robots()
    assert run_cli(cli, ["plugin", "push", name, "--all"], "swarmctl", exit_code_of) == 2
    err = capsys.readouterr().err.removeprefix("error: ").rstrip("\n")
    with swarm_of(robots) as swarm, pytest.raises(ConfigError) as error:
        swarm.push(path)
    code = content if len(content) <= MAX_CODE else b""  # the page sends no more
    (answer,) = clicked(robots, file=name, size=len(content), code=code)
    assert str(error.value) == err
    assert answer.line == f"push: {err}"
    assert "\n" not in err
    assert (answer.is_good, answer.is_final) == (False, True)
    assert robots.manifests == []


PATTERN = b"from swarmd.api import *\nclass Own(Pattern[Params]):\n    pass\n"


def test_hostile_folders_are_refused_in_one_line_or_sent_as_they_are(tmp_path: Path) -> None:
    robots = Robots(["r1"])
    folder = write(tmp_path, "own/pattern.py", PATTERN).parent
    with swarm_of(robots) as swarm:

        def refused() -> str:
            with pytest.raises(ConfigError) as error:
                swarm.push(folder)
            text = str(error.value)
            assert "\n" not in text
            assert robots.manifests == []
            return text

        large = write(folder, "weights.bin", bytes(9 * 2**20))
        assert "at most" in refused()
        large.write_bytes(bytes(2 * 2**20))
        assert "1 MiB" in refused()
        large.unlink()
        odd = Path(os.fsdecode(os.fsencode(folder) + b"/\xff.txt"))
        odd.write_bytes(b"")
        assert "UTF-8" in refused()
        odd.unlink()
        two = write(folder, "a\nb.txt", b"")
        assert "lies elsewhere" in refused()
        two.unlink()
        native = write(folder, "fast.so", b"")
        assert "native code" in refused()
        native.unlink()
        os.mkfifo(folder / "pipe")  # no regular file, which is left out: nothing waits for it
        (folder / "loop").symlink_to(folder)  # a folder behind a link is left out, too
        (folder / "gone").symlink_to(tmp_path / "nothing")
        assert swarm.push(folder).taken == ("r1",)
    assert "Own Pattern" in _refusal(write(tmp_path, "Own Pattern/pattern.py", PATTERN).parent)
    assert "pattern.py" in _refusal(tmp_path)
    assert "no such file" in _refusal(tmp_path / "none.py")
    assert "no such file" in _refusal("a\0b.py")
    assert "UTF-8" in _refusal(os.fsdecode(b"/tmp/\xff.py"))


def _refusal(file: str | Path) -> str:
    with pytest.raises(ConfigError) as error:
        ask.source_at(file)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_the_page_pushes_as_python_does() -> None:
    robots = Robots(own=["r3"], silent=["r4"])
    *before, answer = clicked(robots)
    assert before == []
    assert [(name, code) for name, code, _ in answer.replies] == [
        ("r1", "applied"),
        ("r2", "applied"),
        ("r3", "refused"),
    ]
    assert answer.missing == ["r4"]
    assert robots.manifests[-1].targets == ()  # all: also robots that join later
    *_, answer = clicked(robots, targets=["r2"], replace=True)
    assert answer.is_good
    assert list(robots.manifests[-1].targets) == ["r2"]


def test_the_page_tells_how_its_canary_does() -> None:
    *before, answer = clicked(Robots(), canary="1")
    assert [one.is_final for one in before] == [False] * len(before)
    assert "push: canary: r1" in before[0].line
    assert answer.is_good
    (answer,) = [one for one in clicked(Robots(raises=["r1"]), canary="1") if one.is_final]
    assert "nothing was sent to r2, r3, r4" in answer.line


@pytest.mark.parametrize(
    "wrong",
    [
        {"targets": []},
        {"targets": None},
        {"code": CODE[:-1]},
        {"code": None},
        {"size": "70k"},
        {"file": ""},
        {"file": ["own.py"]},
        {"file": "../../etc/own.sh"},
        {"canary": "nobody"},
        {"canary": "-1"},
    ],
)
def test_a_wrong_push_of_a_page_sends_nothing(wrong: dict[str, Any]) -> None:
    robots = Robots()
    (answer,) = [one for one in clicked(robots, **wrong) if one.is_final]
    assert not answer.is_good
    assert robots.manifests == []


def test_swarmctl_prints_the_push_as_before(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    robots = Robots(own=["r3"])
    monkeypatch.setattr(CommonOptions, "operator", lambda options: nullcontext(robots))
    words = ["plugin", "push", str(file), "r1", "r3"]
    assert run_cli(cli, words, "swarmctl", exit_code_of) == 3
    out, err = capsys.readouterr()
    assert out.splitlines()[-1] == "2 targeted, 1 applied, 1 refused (r3)"
    assert err == ""
