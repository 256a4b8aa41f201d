"""What a robot takes, keeps and loads of pushed patterns; whole daemons: tests/swarm."""

from __future__ import annotations

import asyncio
import hashlib
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.errors import ChangedCodeError
from swarmd.core.host_messages import Load, Loaded, LoadRefused, TrialDone
from swarmd.core.messages import Code, Epoch, Reply
from swarmd.core.pattern_manifest import (
    PatternManifest,
    Signed,
    encode_manifest,
    encode_table,
    merged,
    read_entry,
    read_table,
)
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import PushRequest, ReloadRequest
from swarmd.daemon import pattern_versions
from swarmd.daemon.pattern_transfer import PatternIntake, PatternPull
from swarmd.daemon.pattern_versions import PatternVersions, PushedRuns
from swarmd.daemon.store import CodeRecord, PatternFiles
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.keys.content_signature import Purpose, sign
from swarmd.link.keys.private_keys import load_private_key
from swarmd.plugins import Origin
from swarmd.robot.actions import FailedCode
from swarmd.robot.pushed_pattern import HOLD_TIME
from swarmd.settings.settings import load_platform
from tests.support.keys import SwarmKeys, flipped

CODE = b"from swarmd.api import Pattern\n"
EPOCH = Epoch("0123456789ab", 1)


class Control(pattern_versions.PatternControl):
    """The daemon's side: every trial ends at once, with `trial_fault`."""

    def __init__(self) -> None:
        self.store: PatternIntake
        self.trial_fault = ""
        self.tried: list[ReloadRequest] = []
        self.faults: list[str] = []
        self.replies: list[Reply] = []
        self.events: list[str] = []
        self.own: dict[str, Origin] = {}
        self.changes = 0

    def try_code(self, request: ReloadRequest) -> None:
        self.tried.append(request)
        done = self.store.on_event(TrialDone(1, self.trial_fault))
        if done is not None:
            assert isinstance(done, TrialDone)
            self.end_trial(done)

    def end_trial(self, event: TrialDone) -> None:
        is_good = not event.text
        code, refusal = (Code.APPLIED, None) if is_good else (Code.REFUSED, event.refusal)
        self.answer(code, refusal, event.text)

    def answer(self, code: Code, refusal: Refusal | None, text: str) -> None:
        """The robot's answer to the latest trial."""
        reply = Reply(id=self.tried[-1].id, robot="r1", code=code, refusal=refusal, text=text)
        self.reply(self.store.on_reply(reply))

    def code_changed(self) -> None:
        self.changes += 1

    def reply(self, reply: Reply) -> None:
        self.replies.append(reply)

    def event(self, text: str) -> None:
        self.events.append(text)

    def fault(self, text: str) -> None:
        self.faults.append(text)

    def epoch(self) -> Epoch:
        return EPOCH

    def labels(self) -> tuple[str, ...]:
        return ()

    def own_patterns(self) -> Mapping[str, Origin]:
        return self.own


class GatedFiles(PatternFiles):
    """Files on a disk that takes no write while `is_open` is not set, and fails with `error`."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.is_open, self.is_asked = threading.Event(), threading.Event()
        self.is_open.set()
        self.error: OSError | None = None
        self.written = 0

    def write(self, record: CodeRecord) -> None:
        self.is_asked.set()
        assert self.is_open.wait(60.0)
        if self.error is not None:
            raise self.error
        super().write(record)
        self.written += 1

    @contextmanager
    def stuck(self) -> Iterator[None]:
        """Let no write end in the block."""
        self.is_open.clear()
        self.is_asked.clear()
        try:
            yield
        finally:
            self.is_open.set()


class Rig:
    """One store in a folder; each start reads what the one before has written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.keys: SwarmKeys | None = None
        self.operators: Mapping[str, bytes] | None = None
        self._generation = 0
        self.control: Control
        self.store: PatternIntake
        self.state: PatternVersions
        self._is_started = False

    async def start(self) -> None:
        if self._is_started:
            await self.state.close()
        self._is_started = True
        control = self.control = Control()
        self.files = GatedFiles(self.folder / "patterns")
        self.state = PatternVersions(self.files, "r1", "lab", lambda: self.operators)
        self.store = control.store = PatternIntake(self.state, DropCounter())
        self.runs = PushedRuns(self.state)
        await self.state.open(control)

    def secure(self) -> None:
        self.keys = SwarmKeys(self.folder / "keys", "lab", ["r1"], operators=["alice", "bob"])
        self.operators = self.keys.authority.roster.operators

    async def push(
        self,
        code: bytes = CODE,
        signer: str = "alice",
        issuer: str = "alice",
        asked: Mapping[str, Any] = MappingProxyType({}),
        **fields: Any,
    ) -> Reply:
        """Push code as one file by a request with `asked`, and return the robot's reply."""
        self._generation += 1
        digest = hashlib.sha256(code).digest()
        wanted = {"kind": "file", "digest": digest, "size": len(code), "name": "own", **fields}
        content = encode_manifest(
            PatternManifest(swarm="lab", generation=self._generation, issuer=issuer, **wanted)
        )
        signature = b""
        if self.keys is not None and signer:
            signature = sign(load_private_key(self.keys[signer].key), Purpose.MANIFEST, content)
        request = PushRequest(
            id=f"p{self._generation}",
            operator=issuer,
            targets={"r1": EPOCH},
            content=content,
            signature=signature,
            data=code,
            **asked,
        )
        replies, count = list[Reply](), len(self.control.replies)
        self.store.on_push(request, lambda reply, **_: replies.append(reply))
        async with asyncio.timeout(20.0):
            while not replies:
                await asyncio.sleep(0.005)
                replies += self.control.replies[count:]
        return replies[-1]

    def origin(self, name: str = "own", *, generation: int = 1, is_restart: bool = False) -> str:
        """Where a load finds a pattern; empty: nowhere."""
        load = Load(generation, name, (), "r1", PLATFORM, 0, is_restart=is_restart)
        found = self.runs.overlay(self.control.own, load, False)
        return found[name].value if name in found else ""

    def standing(self) -> str:
        (one,) = self.state.report().patterns
        return one.standing


PLATFORM = load_platform("waffle_pi")


@pytest.fixture
def rig(runner: asyncio.Runner, tmp_path: Path) -> Rig:
    made = Rig(tmp_path)
    runner.run(made.start())
    return made


async def test_pushed_code_is_there_after_a_restart(rig: Rig) -> None:
    assert (await rig.push()).code is Code.APPLIED
    assert Path(rig.origin()).read_bytes() == CODE
    await rig.start()
    assert Path(rig.origin()).read_bytes() == CODE
    assert rig.state.digest != b""
    await rig.push(b"", kind="removed", digest=b"")
    assert rig.origin() == ""
    await rig.start()
    assert rig.origin() == ""


async def test_a_push_that_runs_again_starts_as_issued(rig: Rig) -> None:
    times = {"age": 1.0, "planned": 2.0, "clock": "c", "issued": 3.0, "issued_at": {"r1": 4.0}}
    await rig.push(asked={"is_rerun": True, **times})
    (reload,) = rig.control.tried
    assert {name: getattr(reload, name) for name in times} == times
    assert (reload.id, reload.targets, reload.pattern) == ("p1", {"r1": EPOCH}, "own")
    assert (reload.is_rerun, reload.keeps_running) == (True, False)


async def test_with_keys_only_code_that_an_operator_signed_is_taken(rig: Rig) -> None:
    rig.secure()
    for signer, issuer in (("", "alice"), ("bob", "alice"), ("r1", "alice"), ("bob", "mallory")):
        reply = await rig.push(signer=signer, issuer=issuer)
        assert (reply.code, reply.refusal) == (Code.REFUSED, Refusal.NOT_SIGNED), signer
    assert rig.origin() == ""
    assert not (rig.folder / "patterns" / "own").exists()
    assert (await rig.push(signer="bob", issuer="bob")).code is Code.APPLIED
    assert rig.origin() != ""


async def test_a_push_with_the_other_signature_of_its_content_is_refused(rig: Rig) -> None:
    rig.secure()
    assert (await rig.push()).code is Code.APPLIED
    (known,) = rig.state.table
    other = Signed(known.signed.content, flipped(known.signed.signature))
    assert not rig.state.is_trusted(read_entry(other))
    assert not rig.state.versions["own"].lacks(read_entry(other))
    rig.state.set_table(merged(rig.state.table, [read_entry(other)]))
    assert [entry.signed for entry in rig.state.table] == [known.signed]


async def test_without_keys_on_a_network_no_code_is_taken(rig: Rig) -> None:
    await rig.push()
    rig.operators = {}
    assert (await rig.push(CODE + b"# new\n")).refusal is Refusal.NOT_SIGNED
    await rig.start()
    assert rig.origin() == ""


async def test_code_from_before_the_keys_and_of_a_revoked_operator_is_not_loaded(rig: Rig) -> None:
    await rig.push()
    rig.secure()
    await rig.start()
    assert rig.origin() == ""
    assert rig.state.table == ()
    await rig.push()
    assert rig.origin() != ""
    rig.operators = {name: key for name, key in (rig.operators or {}).items() if name == "bob"}
    await rig.state.check_again()
    assert (rig.origin(), rig.control.changes) == ("", 1)
    assert rig.standing() == "returned"


async def test_code_that_a_host_found_changed_is_missing_until_it_is_pushed_again(rig: Rig) -> None:
    await rig.push()
    Path(rig.origin()).write_bytes(b"something else")
    refused = LoadRefused(1, "own was changed", Refusal.CHANGED_CODE)
    assert rig.store.on_event(refused) is refused
    await happens(lambda: rig.standing() == "missing")
    with pytest.raises(ChangedCodeError):
        rig.origin()
    (listed,) = rig.state.report().patterns
    assert (listed.standing, listed.digest, "changed" in listed.text) == ("missing", "", True)
    assert len(rig.control.faults) == 1
    assert (await rig.push()).code is Code.APPLIED
    assert (Path(rig.origin()).read_bytes(), rig.standing()) == (CODE, "provisional")


@pytest.mark.parametrize("name", ["record", "code"])
async def test_a_name_of_a_file_of_the_daemon_is_a_name_of_a_pattern(rig: Rig, name: str) -> None:
    assert (await rig.push(name=name)).code is Code.APPLIED
    await rig.start()
    assert Path(rig.origin(name)).read_bytes() == CODE


async def test_code_that_was_damaged_on_the_disk_is_not_loaded(rig: Rig) -> None:
    await rig.push()
    Path(rig.origin()).write_bytes(b"something else")
    await rig.start()
    with pytest.raises(ChangedCodeError):
        rig.origin()
    assert any("damaged" in text for text in rig.control.faults)
    (wanted,) = rig.state.missing()  # another robot may have it
    rig.store.take(wanted, CODE, "r2")
    async with asyncio.timeout(20.0):
        while not rig.control.replies:
            await asyncio.sleep(0.005)
    assert Path(rig.origin()).read_bytes() == CODE


async def test_a_pattern_of_the_robot_is_hidden_only_on_request(rig: Rig) -> None:
    rig.control.own["own"] = Origin("mine.py", "plugin_dir", is_file=True)
    assert (await rig.push()).refusal is Refusal.NAME_TAKEN
    assert rig.origin() == "mine.py"
    assert (await rig.push(replaces=True)).code is Code.APPLIED
    assert rig.origin() != "mine.py"


async def test_code_that_cannot_be_written_is_refused_and_nothing_changes(rig: Rig) -> None:
    (rig.folder / "patterns").write_bytes(b"a file where the folder should be")
    reply = await rig.push()
    assert reply.refusal is Refusal.BUSY  # it passes: the robot pulls the code again
    assert "cannot be written" in reply.text
    assert (rig.origin(), rig.state.table) == ("", ())


async def happens(condition: Callable[[], bool]) -> None:
    """Wait on the loop, which goes on meanwhile."""
    async with asyncio.timeout(60.0):
        while not condition():
            await asyncio.sleep(0.005)


@pytest.mark.parametrize("what", ["code", "newer manifest", "removal"])
async def test_a_push_is_applied_when_it_is_on_the_disk_and_the_loop_goes_on_meanwhile(
    rig: Rig, what: str
) -> None:
    if what != "code":
        await rig.push()
    before = rig.state.table
    fields: dict[str, Any] = {"kind": "removed", "digest": b""} if what == "removal" else {}
    count = len(rig.control.replies)
    with rig.files.stuck():
        pushing = asyncio.create_task(rig.push(b"" if what == "removal" else CODE, **fields))
        await happens(rig.files.is_asked.is_set)
        for _ in range(20):  # ticks
            await asyncio.sleep(0.005)
        assert len(rig.control.replies) == count
        assert rig.state.table == before  # nor do the peers see it
    assert (await pushing).code is Code.APPLIED
    assert read_table(rig.files.read().table) == rig.state.table != before
    assert (rig.origin() == "") == (what == "removal")


async def test_a_change_while_a_push_is_written_does_not_lose_it(rig: Rig) -> None:
    with rig.files.stuck():
        pushing = asyncio.create_task(rig.push())
        await happens(rig.files.is_asked.is_set)
        content = encode_manifest(
            PatternManifest(
                swarm="lab", name="far", generation=9, issuer="bob", kind="removed", targets=("r7",)
            )
        )
        rig.store.merge([read_entry(Signed(content))])
    assert (await pushing).code is Code.APPLIED
    await rig.start()
    assert {entry.manifest.name for entry in rig.state.table} == {"own", "far"}
    assert rig.origin() != ""


async def test_a_version_that_cannot_be_written_is_refused_and_may_be_pushed_again(
    rig: Rig,
) -> None:
    rig.files.error = OSError(28, "No space left on device")
    reply = await rig.push()
    assert (reply.code, reply.refusal) == (Code.REFUSED, Refusal.BUSY)
    assert (rig.origin(), rig.state.table) == ("", ())
    await rig.push()
    assert len(rig.control.faults) == 1
    rig.files.error = None
    assert (await rig.push()).code is Code.APPLIED
    await rig.start()
    assert rig.origin() != ""


@pytest.mark.parametrize(
    ("refusal", "told"),
    [
        (Refusal.OVERTAKEN, Refusal.OVERTAKEN),
        (Refusal.PATTERN_FAILED, Refusal.BUSY),  # the disk was slow: no fault of the code
    ],
)
async def test_a_trial_that_the_robot_ends_while_it_is_written_changes_nothing(
    rig: Rig, refusal: Refusal, told: Refusal
) -> None:
    with rig.files.stuck():
        pushing = asyncio.create_task(rig.push())
        await happens(rig.files.is_asked.is_set)
        rig.control.answer(Code.REFUSED, refusal, "stopped, or it took more than 10 s")
        assert (await pushing).refusal is told
    await happens(lambda: rig.files.written == 2)
    await rig.start()
    assert (rig.origin(), rig.state.table, rig.state.versions) == ("", (), {})
    assert (await rig.push()).code is Code.APPLIED


async def test_a_push_waits_for_one_that_the_robot_gave_up_while_it_is_written(rig: Rig) -> None:
    with rig.files.stuck():
        first = asyncio.create_task(rig.push())
        await happens(rig.files.is_asked.is_set)
        rig.control.answer(Code.REFUSED, Refusal.OVERTAKEN, "stopped")
        await first
        second = asyncio.create_task(rig.push(CODE + b"# new\n"))
        for _ in range(20):
            await asyncio.sleep(0.005)
        assert len(rig.control.tried) == 1
    assert (await second).code is Code.APPLIED
    await rig.start()
    assert Path(rig.origin()).read_bytes() == CODE + b"# new\n"
    assert (await rig.push()).code is Code.APPLIED


async def test_a_run_that_is_restarted_keeps_its_code(rig: Rig) -> None:
    await rig.push()
    old = rig.origin(generation=1)
    await rig.push(CODE + b"# new\n")
    assert rig.origin(generation=2, is_restart=True) == old
    assert rig.origin(generation=3) != old
    assert not rig.runs.is_provisional(2)  # a fault of the old code is no fault of the new


async def test_a_fault_returns_and_a_long_run_holds(rig: Rig) -> None:
    await rig.push()
    old = rig.origin(generation=1)
    for now in (0.0, 1.0, HOLD_TIME - 1.0):
        rig.runs.advance(now, 1, is_running=True)
    assert rig.standing() == "provisional"
    rig.runs.advance(HOLD_TIME + 1.0, 1, is_running=True)
    assert rig.standing() == "held"
    reply = await rig.push(CODE + b"# new\n")
    assert reply.code is Code.APPLIED, reply
    assert rig.origin(generation=2) != old
    rig.runs.on_failed(FailedCode(2, "ZeroDivisionError"))
    assert (rig.standing(), rig.origin(generation=3)) == ("returned", old)
    await rig.start()
    assert (rig.standing(), rig.origin(generation=1)) == ("returned", old)


async def test_a_daemon_that_dies_in_runs_of_provisional_code_returns(rig: Rig) -> None:
    await rig.push()
    old = rig.origin()
    rig.runs.advance(0.0, 1, is_running=True)
    rig.runs.advance(HOLD_TIME, 1, is_running=True)
    await rig.push(CODE + b"# new\n")
    for _ in range(3):  # they stay open
        assert rig.origin() != old
        await rig.start()
    assert (rig.standing(), rig.origin()) == ("returned", old)


async def test_an_older_push_never_replaces_a_newer_one(rig: Rig) -> None:
    await rig.push()
    await rig.push()
    rig._generation = 0
    assert (await rig.push(CODE + b"# older\n")).refusal is Refusal.OVERTAKEN


async def test_a_push_of_what_is_being_pulled_waits_and_is_applied(rig: Rig) -> None:
    digest = hashlib.sha256(CODE).digest()
    manifest = PatternManifest(
        swarm="lab",
        name="own",
        generation=1,
        issuer="alice",
        kind="file",
        digest=digest,
        size=len(CODE),
    )
    entry = read_entry(Signed(encode_manifest(manifest)))
    rig.store.take(entry, CODE, "r2")
    request = PushRequest(
        id="p1", operator="alice", targets={"r1": EPOCH}, content=entry.signed.content, data=CODE
    )
    replies: list[Reply] = []
    rig.store.on_push(request, lambda reply, **_: replies.append(reply))
    assert replies == []  # the reply follows
    async with asyncio.timeout(20.0):
        while len(rig.control.replies) < 2:
            await asyncio.sleep(0.005)
    assert [(reply.id[:4], reply.code) for reply in rig.control.replies] == [
        ("pull", Code.APPLIED),
        ("p1", Code.APPLIED),
    ]


@pytest.mark.parametrize(
    "spoil", [lambda code: code + b"x", lambda code: code[:-1] + b"x"], ids=["longer", "other"]
)
async def test_code_that_is_not_that_of_its_manifest_is_refused(
    rig: Rig, spoil: Callable[[bytes], bytes]
) -> None:
    digest = hashlib.sha256(CODE).digest()
    reply = await rig.push(spoil(CODE), digest=digest, size=len(CODE))
    assert reply.refusal is Refusal.PATTERN_FAILED
    assert rig.origin() == ""


async def test_another_robot_s_pushed_patterns_are_kept_in_the_table_alone(rig: Rig) -> None:
    content = encode_manifest(
        PatternManifest(
            swarm="lab",
            name="far",
            generation=9,
            issuer="bob",
            kind="file",
            digest=bytes(32),
            targets=("r7",),
        )
    )
    rig.store.merge([read_entry(Signed(content))])
    assert rig.state.missing() == []
    assert rig.state.report().generation == 9
    assert rig.state.report().patterns == ()


class Pulling:
    """A puller that gets `blob` from each robot that is asked."""

    def __init__(self, blob: bytes) -> None:
        self.blob = blob
        self.asked: list[str] = []

    def pull(self, peer: str, *_: Any, on_done: Callable[[bytes, str], object], **__: Any) -> bool:
        self.asked.append(peer)
        on_done(self.blob, "")
        return True


async def test_a_table_with_false_signatures_costs_one_check(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.secure()
    manifest = PatternManifest(
        swarm="lab", name="own", generation=1, issuer="eve", kind="removed", targets=("r7",)
    )
    foreign = [Signed(encode_manifest(manifest), bytes(64))]
    false = [
        Signed(encode_manifest(replace(manifest, name=f"b{n}", issuer="bob")), bytes(64))
        for n in range(256)
    ]
    checked: list[bytes] = []

    def check(key: bytes, purpose: Purpose, content: bytes, signature: bytes) -> bool:
        checked.append(content)
        return False

    monkeypatch.setattr(pattern_versions, "is_signed_by", check)
    puller = Pulling(encode_table(map(read_entry, (*foreign, *false))))
    sync = PatternPull(rig.state, rig.store, puller, lambda *_: None, DropCounter())  # type: ignore[arg-type]
    digests = (number.to_bytes(4, "big") + b"xx" for number in range(1, 100))
    for digest in digests:
        sync.on_beacon("r2", digest, ("127.0.0.1", 1), boottime())
        if sync._checking is not None:
            await sync._checking
    assert puller.asked == ["r2"]
    assert len(checked) == 1
    assert rig.state.table == ()


@pytest.mark.parametrize("where", ["files of the store", "second check of the manifest"])
async def test_a_fault_in_the_check_of_a_push_is_a_failure_and_the_next_push_is_taken(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    checks: list[Any] = []

    def fails(*entries: Any) -> None:
        checks.extend(entries)
        if where == "files of the store" or len(checks) == 2:
            raise ZeroDivisionError

    with monkeypatch.context() as patches:
        if where == "files of the store":
            patches.setattr(rig.files, "prune", fails)
        else:  # the first check is that of the request, the second that of the queued entry
            patches.setattr(rig.store, "_refusal_of", fails)
        reply = await rig.push()
    assert (reply.code, reply.refusal) == (Code.FAILED, None)
    assert (await rig.push()).code is Code.APPLIED


@pytest.mark.parametrize("replaces", [False, True])
async def test_a_run_of_changed_code_is_refused_and_no_older_version_runs(
    rig: Rig, replaces: bool
) -> None:
    """Nor a pattern of the robot that the code replaced, also after a restart."""
    if replaces:
        rig.control.own["own"] = Origin("mine.py", "plugin_dir", is_file=True)
    newer = CODE + b"# new\n"
    await rig.push(replaces=replaces)
    old = rig.origin()
    await rig.push(newer, replaces=replaces)
    Path(rig.origin(generation=2)).unlink()
    rig.store.on_event(LoadRefused(2, "own was removed", Refusal.CHANGED_CODE))
    await happens(lambda: rig.standing() == "missing")
    for _ in range(2):
        with pytest.raises(ChangedCodeError):
            rig.origin(generation=3)
        await rig.start()
        if replaces:
            rig.control.own["own"] = Origin("mine.py", "plugin_dir", is_file=True)
    assert (await rig.push(newer, replaces=replaces)).code is Code.APPLIED
    assert Path(rig.origin(generation=4)).read_bytes() == newer
    rig.runs.on_failed(FailedCode(4, "ZeroDivisionError"))
    assert rig.origin(generation=5) == old  # which the damage did not touch


async def test_a_mission_finds_no_other_part_in_place_of_changed_code(rig: Rig) -> None:
    mine = Origin("mine.py", "plugin_dir", is_file=True)
    rig.control.own["own"] = rig.control.own["mission"] = mine
    await rig.push(replaces=True)
    Path(rig.origin()).unlink()
    await rig.state.check_again()
    load = Load(2, "mission", (), "r1", PLATFORM, 0)
    assert set(rig.runs.overlay(rig.control.own, load, False)) == {"mission"}


@pytest.mark.parametrize("is_pushed", [True, False])
async def test_pushed_code_may_not_go_on_with_late_scans(rig: Rig, is_pushed: bool) -> None:
    rig.control.own["mine"] = Origin("mine.py", "plugin_dir", is_file=True)
    await rig.push()
    rig.origin("own" if is_pushed else "mine", generation=7)
    loaded = Loaded(7, 10.0, frozenset(), {}, scan_delay=0.5)
    granted = rig.runs.granted(loaded)
    assert isinstance(granted, Loaded)
    assert (granted.scan_delay, granted.note != "") == ((0.0, True) if is_pushed else (0.5, False))
