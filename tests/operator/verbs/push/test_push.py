"""What swarmctl refuses to push before anything is sent, and what a list marks."""

from __future__ import annotations

import hashlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from swarmd.core.errors import RequestError, SwarmError
from swarmd.core.pattern_manifest import MAX_CODE, PatternManifest, encode_manifest
from swarmd.core.verbs import PushedPatternReport, PushedPatternsReply
from swarmd.link.keys.content_signature import Purpose, sign
from swarmd.link.keys.private_keys import load_private_key
from swarmd.operator.verbs.push import ask
from swarmd.operator.verbs.push.ask import Pusher, differing, greatest_of, read_source
from tests.support.keys import SwarmKeys


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("own.py", b"x = 1\n\ndef broken(:\n", "own.py:3"),
        ("own.py", b"\xff\xfe", "own.py"),
        ("own.py", b"#" * (MAX_CODE + 1), "1 MiB"),
        ("Own Pattern.py", b"", "Own Pattern"),
        ("own.yaml", b"", ".whl"),
        ("own.whl", b"no zip", "no wheel"),
    ],
)
def test_files_that_cannot_be_pushed_are_refused_in_one_line(
    name: str, content: bytes, told: str, tmp_path: Path
) -> None:
    file = tmp_path / name
    file.write_bytes(content)
    with pytest.raises(SwarmError) as error:
        read_source(file)
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_is_the_pattern_of_its_name(tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_bytes(b"x = 1\n")
    source = read_source(file)
    assert (source.name, source.kind, source.code) == ("own", "file", b"x = 1\n")


def test_robots_that_differ_from_most_are_marked() -> None:
    def reply(robot: str, **hashes: str) -> PushedPatternsReply:
        rows = tuple(
            PushedPatternReport(name=name, standing="held", digest=digest)
            for name, digest in hashes.items()
        )
        return PushedPatternsReply(robot=robot, patterns=rows)

    found = {
        "r1": reply("r1", own="a", other="x"),
        "r2": reply("r2", own="a"),
        "r3": reply("r3", own="b", other="x"),
    }
    assert differing(found) == {("r3", "own")}


def test_generations_of_pushed_patterns_count_by_their_signatures(tmp_path: Path) -> None:
    keys = SwarmKeys(tmp_path, "lab", ["r1"], operators=["alice"])

    def reply(generation: int, *, is_signed: bool) -> PushedPatternsReply:
        manifest = PatternManifest(
            swarm="lab", name="own", generation=generation, issuer="alice", kind="removed"
        )
        content = encode_manifest(manifest)
        key = load_private_key(keys["alice"].key)
        return PushedPatternsReply(
            robot="r1",
            generation=generation,
            newest=content,
            signature=sign(key, Purpose.MANIFEST, content) if is_signed else bytes(64),
        )

    replies = (
        reply(7, is_signed=True),
        reply(2**32 - 1, is_signed=False),
        PushedPatternsReply(robot="r2", generation=2**40),
    )
    assert greatest_of(replies, keys["alice"]) == 7
    assert greatest_of((), keys["alice"]) == 0
    assert greatest_of(replies[:2], None) == 2**32 - 1


def test_without_an_answer_no_generation_is_guessed(monkeypatch: pytest.MonkeyPatch) -> None:
    view: Any = SimpleNamespace(members={"r1": None, "r2": None})
    operator = SimpleNamespace(identity=None)
    targeted: Any = SimpleNamespace(session=None, operator=operator, view=view)
    pusher = Pusher(targeted, None)
    answers = {"r2": PushedPatternsReply(robot="r2", generation=4)}
    monkeypatch.setattr(ask, "pushed_patterns_of", lambda *_: answers)
    assert pusher.next_generation() == 5
    answers.clear()
    with pytest.raises(RequestError, match="from r1, r2; nothing was sent"):
        pusher.next_generation()


def test_the_wait_for_a_canary_is_told_at_intervals(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a canary that runs new code for 90 s, with a clock that the waits wind."""
    clock = [0.0]
    code = b"code"
    digest = hashlib.sha256(code).hexdigest()[: ask.DIGEST_LENGTH]
    report = PushedPatternReport(name="own", standing="provisional", digest=digest)
    answers = {"r1": PushedPatternsReply(robot="r1", patterns=(report,))}

    def wait(seconds: float) -> None:
        clock[0] += seconds

    operator = SimpleNamespace(
        members=lambda timeout: None, loops=SimpleNamespace(turn=lambda *_: None)
    )
    monkeypatch.setattr(ask, "pushed_patterns_of", lambda *_: answers)
    monkeypatch.setattr(ask, "_runs", lambda *_: True)
    monkeypatch.setattr(ask, "time", SimpleNamespace(monotonic=lambda: clock[0], sleep=wait))
    told: list[str] = []
    session: Any = SimpleNamespace(
        timeout=None, operator=operator, tell=told.append, is_cancelled=lambda: False
    )
    source = ask.Source("own", "file", "", "", code)
    assert "not held yet" in ask.await_canary(session, source, ["r1"], ["r2"], 90.0)
    assert [line.partition(" s,")[0] for line in told] == [
        f"canary r1: {seconds}" for seconds in range(10, 90, 10)
    ]
