"""Transfers pushed patterns to a robot: receives, checks, writes, tries and adopts their code.

1. A thread checks signature and SHA-256 of the code, and writes its files.
2. The robot tries the code in a pattern host of its own, as for a reload.
3. After a successful trial a thread writes the record of the new version to disk.
4. After this write the version is current, and the robot acts on the end of the trial.

A push starts and stops no run, with one exception: the robot may join a valid goal that it could
not join before because it lacked the code (`robot/goals.py`).

Robots also pull from each other. A beacon shows a digest of the table (all signed manifests). A
robot that joined late, was cut off or restarted pulls the table of a peer with another digest,
checks the signatures, and pulls the code that it lacks. Nothing is sent while all digests agree.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Collection, Coroutine, Mapping
from functools import partial
from typing import NamedTuple

from msgspec.structs import replace

from swarmd.core.bounds import keep_newest
from swarmd.core.clock import Clock, boottime
from swarmd.core.errors import CodecError, PluginError
from swarmd.core.host_messages import HostEvent, LoadRefused, TrialDone
from swarmd.core.messages import Code, Epoch, Reply
from swarmd.core.pattern_manifest import (
    Entry,
    Signed,
    decode_table,
    encode_table,
    merged,
    read_entry,
)
from swarmd.core.record import may_replace
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import (
    Nothing,
    PushedPatternsReply,
    PushRequest,
    ReloadRequest,
    shared_fields,
)
from swarmd.daemon.pattern_versions import Candidate, PatternVersions
from swarmd.daemon.requests import SendReply
from swarmd.link.carriers.bus import ZenohBus
from swarmd.link.carriers.inbound_queue import FAILED, DropCounter
from swarmd.link.datagram import Address
from swarmd.link.spread.asks import Asks
from swarmd.link.spread.pull import Blob, Puller, serve_shared
from swarmd.robot.pushed_pattern import Version

log = logging.getLogger(__name__)

MAX_QUEUE = 4  # pushed patterns that wait for their check and trial
MAX_UPLOADS = 2  # incomplete pushed patterns that are kept
# Refusals that do not concern the code: the same push may succeed later.
_PASSING = frozenset({Refusal.BUSY, Refusal.OVERTAKEN, Refusal.STALE_EPOCH})


class _CheckedTable(NamedTuple):
    """The result of the check of a pulled table."""

    trusted: list[Entry]  # new entries with a valid signature
    new_count: int  # of entries, also without a valid signature
    has_false_signature: bool  # of an operator of the roster; the check ended there


class PatternIntake:
    """Takes pushed patterns into `state`, one at a time.

    `drops` counts pushed patterns that raised an error.
    """

    def __init__(self, state: PatternVersions, drops: DropCounter) -> None:
        self._state = state
        self._drops = drops
        self._uploads: dict[bytes, bytearray] = {}  # by digest: the pieces that came so far
        self._tasks: set[asyncio.Task[None]] = set()
        self._is_taking = False  # `_take` checks, writes or adopts an entry, without a trial so far
        # The arguments of each call of `_take` to come.
        self._queue: deque[tuple[Entry, bytes, str, PushRequest | None]] = deque()

    def check_again(self) -> None:
        """Check all code again, after a change of the roster or of a file."""
        self._start(self._state.check_again())

    def close(self) -> None:
        """End all work, and end runs in the record: an orderly end is no failure of code."""
        self._queue.clear()
        for task in self._tasks:
            task.cancel()
        state = self._state
        if any(code.is_running for code in state.versions.values()):
            state.versions = {name: code.end() for name, code in state.versions.items()}
            state.save()

    def _start(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # Pushes

    def on_push(self, request: PushRequest, answer: SendReply) -> None:
        """Take a piece of a pattern; the reply to the last piece follows after the trial."""
        if (reply := self._take_piece(request)) is not None:
            answer(reply, is_audited=reply.code is not Code.APPLIED)

    def _take_piece(self, request: PushRequest) -> Reply | None:
        try:
            entry = read_entry(Signed(request.content, request.signature))
        except CodecError as error:
            return self._refused(request.id, Refusal.INVALID_REQUEST, str(error))
        if fault := self._refusal_of(entry):
            return self._refused(request.id, *fault)
        manifest = entry.manifest
        code = self._uploads.get(manifest.digest, bytearray())
        keep_newest(self._uploads, manifest.digest, code, MAX_UPLOADS)
        if request.offset > len(code) or len(code) > manifest.size:
            self._uploads.pop(manifest.digest, None)
            text = "a piece of the pushed pattern is missing; push it again"
            return self._refused(request.id, Refusal.INVALID_REQUEST, text)
        code[request.offset :] = request.data
        if len(code) < manifest.size:
            text = f"has {len(code)} of {manifest.size} bytes"
            return Reply(id=request.id, robot=self._state.robot, code=Code.APPLIED, text=text)
        if len(self._queue) >= MAX_QUEUE:
            text = "other pushed patterns are being tried"
            return self._refused(request.id, Refusal.BUSY, text)
        del self._uploads[manifest.digest]
        self.take(entry, bytes(code), f"push of {request.operator}", request)
        return None

    def _refusal_of(self, entry: Entry) -> tuple[Refusal, str] | None:
        """Why this robot refuses a manifest, signature and code aside; None if it is accepted."""
        manifest = entry.manifest
        operators = self._state.operators()
        if manifest.swarm != self._state.swarm:
            return Refusal.NOT_SIGNED, f"it is for swarm {manifest.swarm!r}"
        if operators is not None and not operators:
            text = "this swarm has no keys, without which code is taken in profile dev only"
            return Refusal.NOT_SIGNED, text
        if operators is not None and manifest.issuer not in operators:
            return Refusal.NOT_SIGNED, f"{manifest.issuer} is no operator of the roster"
        if not manifest.is_for(self._state.robot, self._state.control.labels()):
            return Refusal.INVALID_REQUEST, f"{manifest.label} is not for this robot"
        if entry not in merged(self._state.table, [entry]):
            text = f"a push of {manifest.name} that is newer came first; push again"
            return Refusal.OVERTAKEN, text
        if self._state.is_taken(manifest):
            text = f"the robot has a pattern {manifest.name!r} of its own; see --replace"
            return Refusal.NAME_TAKEN, text
        return None

    def take(
        self, entry: Entry, code: bytes, source: str, request: PushRequest | None = None
    ) -> None:
        """Queue a pattern, or a removal, for `_take`.

        `entry`: the signed manifest. `code`: its bytes. `source`: where the code came from, in
        words. `request`: the push to answer at the end; None: the code came from a peer. Entries
        are handled one by one, since a robot may pull a pattern from a peer while an operator
        pushes the same pattern.
        """
        self._queue.append((entry, code, source, request))
        self._take_next()

    def _take_next(self) -> None:
        if self._queue and not self.is_busy:
            self._is_taking = True
            self._start(self._take(*self._queue.popleft()))

    @property
    def is_busy(self) -> bool:
        """True while a pushed pattern is checked, written or tried."""
        state = self._state
        return self._is_taking or state.candidate is not None or state.is_adopting

    async def _take(
        self, entry: Entry, code: bytes, source: str, request: PushRequest | None
    ) -> None:
        """Check and write one pushed pattern and begin its trial, or carry out a removal.

        The trial replies at its end. Without a trial, the reply follows at once: after a refusal, a
        removal, or code that the robot has and need not run again.

        `entry`: the signed manifest. `code`: its bytes, unused if the robot has the code already.
        `source`: where the code came from, in words. `request`: the push; None if the code was
        pulled from a peer, for which no request waits, so that the reply is dropped.
        """
        id = f"pull-{entry.manifest.digest.hex()[:12]}" if request is None else request.id
        is_rerun = request is not None and request.is_rerun  # the robot runs the pattern again
        version = Version.of(entry, source)
        with self._drops.refusing("control/push", partial(self._reply_to_error, id)):
            try:
                reply = await self._written(id, entry, code, version, is_rerun=is_rerun)
            finally:
                self._is_taking = False
            # No await follows, so that no other entry is taken before `_take_next`.
            if reply is not None:
                self._state.control.reply(reply)
            else:
                # Sets `state.candidate`: the intake stays busy until the end of the trial.
                self._try(id, entry, version, request)
        self._take_next()

    async def _written(
        self, id: str, entry: Entry, code: bytes, version: Version, *, is_rerun: bool
    ) -> Reply | None:
        """Check and write an entry; the reply, None if a trial of the code must reply."""
        refusal_and_text = await self._write(entry, code)
        if refusal_and_text is not None:
            return self._refuse(id, entry, version, *refusal_and_text)
        if entry.is_removal or (self._state.has(entry) and not is_rerun):
            return await self._adopt(id, entry)
        return None

    def _reply_to_error(self, id: str, code: Code, text: str) -> None:
        """Reply to a push that raised an error: REFUSED for a CodecError, else FAILED."""
        reply = self._refused(id, Refusal.PATTERN_FAILED, text)
        if code is not Code.REFUSED:
            reply = replace(reply, code=code, refusal=None)
        self._state.control.reply(reply)

    def _refuse(
        self, id: str, entry: Entry, version: Version, refusal: Refusal, text: str
    ) -> Reply:
        """The reply to an entry that `_write` has refused; faulty code is also noted."""
        if refusal is Refusal.PATTERN_FAILED:
            self._state.note_failed(entry, version, text)
        return self._refused(id, refusal, text)

    async def _write(self, entry: Entry, code: bytes) -> tuple[Refusal, str] | None:
        """Check and write the code of an entry; returns the refusal and its text, None if taken.

        The manifest is checked again, since the entry may have waited in the queue. Also deletes
        the files of patterns that are no longer in use.
        """
        refusal_and_text = self._refusal_of(entry)
        await asyncio.to_thread(self._state.files.prune, self._state.in_use())
        if refusal_and_text is None:
            refusal_and_text = await asyncio.to_thread(self._write_checked, entry, code)
        return refusal_and_text

    def _write_checked(self, entry: Entry, code: bytes) -> tuple[Refusal, str] | None:
        """In a thread: check the signature, then write the code; the refusal, None on success."""
        if not self._state.is_trusted(entry):
            text = f"{entry.manifest.label} is not signed by {entry.manifest.issuer}"
            return Refusal.NOT_SIGNED, text
        try:
            if not entry.is_removal and not self._state.has(entry):
                self._state.files.add(entry.manifest, code)
        except PluginError as error:
            return Refusal.PATTERN_FAILED, str(error)
        except OSError as error:
            return Refusal.BUSY, f"{entry.manifest.label} cannot be written: {error.strerror}"
        return None

    async def _adopt(self, id: str, entry: Entry) -> Reply:
        """Adopt a manifest that needs no trial: a removal, or a newer manifest of current code."""
        robot = self._state.robot
        name = entry.manifest.name
        is_here = name in self._state.versions

        def is_wanted() -> bool:
            # A fault may have replaced the current code since.
            return entry.is_removal or self._state.has(entry)

        if fault := await self._state.adopt(entry, Version.of(entry, ""), is_wanted):
            return Reply(id=id, robot=robot, code=Code.FAILED, text=fault)
        if entry.is_removal:
            text = f"{name} is removed" if is_here else f"had no pushed {name}"
            self._tell_of_removal(text, entry)
        else:
            standing = self._state.versions[name].standing
            text = f"has {entry.manifest.label} already: {standing}"
        return Reply(id=id, robot=robot, code=Code.APPLIED, text=text)

    def _tell_of_removal(self, text: str, entry: Entry) -> None:
        self._state.control.event(f"{text}, by {entry.manifest.issuer}")
        self._state.control.code_changed()

    def _try(self, id: str, entry: Entry, version: Version, request: PushRequest | None) -> None:
        """Begin the trial of the code of `entry`; `on_event` and `on_reply` take its end."""
        self._state.candidate = Candidate(id, entry, version)
        targets: dict[str, Epoch | None] = {self._state.robot: self._state.control.epoch()}
        reload = ReloadRequest(
            id=id,
            operator=entry.manifest.issuer if request is None else request.operator,
            targets=targets,
            pattern=entry.manifest.name,
            keeps_running=True,
        )
        # Only a rerun moves the robot, so only a rerun needs the epoch (count of the robot's
        # changes) that the operator saw, and the time at which it was issued. Any other trial
        # quotes the present epoch, which the robot does not refuse.
        if request is not None and request.is_rerun:
            asked = {**shared_fields(request, ReloadRequest), "id": id, "keeps_running": False}
            reload = replace(reload, **asked)
        self._state.control.try_code(reload)

    def on_event(self, event: HostEvent) -> HostEvent | None:
        """Take an event of the pattern host, and return the event to hand to the robot.

        None for a successful trial: the robot gets this event later, once the version is on disk.
        """
        if isinstance(event, LoadRefused) and event.refusal is Refusal.CHANGED_CODE:
            self.check_again()
        candidate = self._state.candidate
        if candidate is None or not isinstance(event, TrialDone) or event.text:
            return event
        self._state.candidate = passed = replace(candidate, is_passed=True)
        self._start(self._accept(passed, event))
        return None

    async def _accept(self, candidate: Candidate, event: TrialDone) -> None:
        """Write the record of a version that passed its trial, then hand `event` to the robot."""
        state = self._state
        entry = candidate.entry
        version = candidate.version

        def is_wanted() -> bool:
            return state.candidate is candidate  # False after the robot has ended the trial itself

        fault = FAILED
        with self._drops.refusing("control/push"):
            fault = await state.adopt(entry, version, is_wanted)
        if not is_wanted():
            self._take_next()
            return
        if fault:
            state.control.end_trial(TrialDone(event.generation, fault, Refusal.BUSY))
            return
        state.candidate = replace(candidate, is_accepted=True)
        state.control.event(f"{entry.manifest.label} is provisional, from {version.source}")
        state.control.end_trial(event)

    def on_reply(self, reply: Reply) -> Reply:
        """Take a reply of the robot before it is sent; returns the reply to send.

        The reply to a trial ends the trial. After a successful trial the text of the reply also
        says that the version is provisional: after a fault the robot returns to the version before.
        """
        candidate = self._state.candidate
        if candidate is None or reply.id != candidate.id:
            return reply
        self._state.candidate = None
        asyncio.get_running_loop().call_soon(self._take_next)
        label = candidate.entry.manifest.label
        if candidate.is_accepted:
            return replace(reply, text=f"{label} is provisional; {reply.text}"[:300])
        if reply.refusal in _PASSING:
            return reply
        if candidate.is_passed:  # the write took longer than TRIAL_TIMEOUT
            text = f"{label} passed its trial, but the disk is slow: it is not written yet"
            return replace(reply, refusal=Refusal.BUSY, text=text)
        self._state.note_failed(candidate.entry, candidate.version, reply.text)
        return reply

    def _refused(self, id: str, refusal: Refusal, text: str) -> Reply:
        text = text[:300]
        return Reply(id=id, robot=self._state.robot, code=Code.REFUSED, refusal=refusal, text=text)

    def merge(self, entries: Collection[Entry]) -> None:
        """Add trusted manifests of other robots to the table, and carry out removals."""
        state = self._state
        state.set_table(merged(state.table, entries))
        for name, entry in state.wanted().items():
            is_here = name in state.versions
            if is_here and entry.is_removal:
                state.apply(entry, Version.of(entry, ""))
                self._tell_of_removal(f"{name} is removed", entry)
            elif is_here and state.has(entry) and state.versions[name].lacks(entry):
                state.apply(entry, Version.of(entry, ""))
        state.save()


TABLE = "patterns"
CODE = "pattern"
# s until the same table or code is pulled from the same robot again: the robot may lack the code,
# or its manifests may be signed by an operator who is not on the own roster.
TABLE_PERIOD = 30.0
CODE_PERIOD = 5.0
FALSE_PERIOD = 300.0
"""s for which nothing is pulled from a robot that handed over a false signature. To refuse one
takes 4 ms of a core, and an honest robot keeps only verified entries."""


class PatternPull:
    """Pulls missing manifests and code from peers, and serves its own to peers that ask.

    `puller` fetches the manifests and code that `state` lacks, and `store` takes the code.
    `on_taken(robot, entry)` is called when code from a peer goes into its trial. `drops` counts
    unreadable tables. `clock` gives the time at which a check has ended, as `now` of `on_beacon`.
    """

    def __init__(
        self,
        state: PatternVersions,
        store: PatternIntake,
        puller: Puller,
        on_taken: Callable[[str, Entry], None],
        drops: DropCounter,
        clock: Clock = boottime,
    ) -> None:
        self._drops = drops
        self._state = state
        self._store = store
        self._on_taken = on_taken
        self._clock = clock
        self._puller = puller
        self._asks = Asks(CODE_PERIOD)
        # (changes of `state`, labels) at which no code was missing.
        self._complete_at: tuple[int, tuple[str, ...]] = (-1, ())
        self._checking: asyncio.Task[None] | None = None

    def serve(self, bus: ZenohBus) -> None:
        """Hand tables and code to other robots."""
        state = self._state
        serve_shared(bus, TABLE, lambda name, asker: encode_table(state.table))
        serve_shared(bus, CODE, lambda name, asker: state.shared_code(name))

    @property
    def digest(self) -> bytes:
        """The digest of the table, for beacons."""
        return self._state.digest

    def on_plugins(self, _: Nothing) -> PushedPatternsReply:
        """The pushed patterns of this robot."""
        return self._state.report()

    def close(self) -> None:
        """Cancel the present check of a pulled table."""
        if self._checking is not None:
            self._checking.cancel()

    def on_beacon(self, robot: str, digest: bytes, address: Address, now: float) -> None:
        """Pull table or code from `robot`, whose beacon shows `digest` of its table."""
        is_busy = self._checking is not None or self._store.is_busy
        if not digest or is_busy or not self._asks.may(robot, now):
            return
        is_new = may_replace(digest, self._state.digest)
        if not is_new or not self._pull_table(robot, digest, address, now):
            self._pull_code(robot, address, now)

    def _pull_table(self, robot: str, digest: bytes, address: Address, now: float) -> bool:
        """Pull the table of `robot` if it may be asked now; True if the pull has begun."""

        def on_done(blob: Blob, reason: str) -> None:
            if blob is None:
                log.info("the pushed patterns of %s are not known: %s", robot, reason)
                self._asks.wait((robot, digest), now + CODE_PERIOD)
            else:
                self._checking = asyncio.get_running_loop().create_task(
                    self._check(robot, address, blob)
                )

        if not self._asks.may((robot, digest), now):
            return False
        is_begun = self._puller.pull(robot, address, TABLE, on_done=on_done)
        if is_begun:
            self._asks.wait((robot, digest), now + TABLE_PERIOD)
        return is_begun

    def _pull_code(self, robot: str, address: Address, now: float) -> None:
        """Pull the code of the first missing pattern that may be asked of `robot` now."""
        present = self._state.changes, tuple(self._state.control.labels())
        if self._complete_at == present:
            return
        missing = self._state.missing()
        if not missing:
            self._complete_at = present
        for entry in missing:
            wanted = entry.manifest.digest
            if not self._asks.may((robot, wanted), now):
                continue
            if self._puller.pull(
                robot,
                address,
                CODE,
                wanted.hex(),
                limit=entry.manifest.size,
                digest=wanted,
                on_done=partial(self._on_code, robot, entry),
            ):
                self._asks.wait((robot, wanted), now + CODE_PERIOD)
            return

    async def _check(self, robot: str, address: Address, blob: bytes) -> None:
        """Check a table of manifests that was pulled from `robot`, and take its signed entries.

        `address`: the address of `robot`, from which a missing pattern is then pulled. `blob`: the
        encoded table, in which each entry is a signed manifest. After a forged entry nothing is
        pulled from `robot` for FALSE_PERIOD.
        """
        state = self._state
        known = frozenset(state.table)
        operators = state.operators()

        with self._drops.refusing(
            f"shared/{TABLE}", lambda _code, text: log.warning("%s: %s", robot, text)
        ):
            try:
                checked = await asyncio.to_thread(self._checked, blob, known, operators)
            finally:
                self._checking = None  # the next table may be checked
            if checked.has_false_signature:
                self._asks.wait(robot, self._clock() + FALSE_PERIOD)
            has_untrusted = len(checked.trusted) < checked.new_count
            if has_untrusted:
                log.warning(
                    "%s has patterns that no operator of the roster signed; they are left out",
                    robot,
                )
            if checked.trusted:
                self._store.merge(checked.trusted)
                self._pull_code(robot, address, self._clock())

    def _checked(
        self, blob: bytes, known: Collection[Entry], operators: Mapping[str, bytes] | None
    ) -> _CheckedTable:
        """In a thread: verify the new entries of a table, at 4 ms a signature.

        `blob`: the encoded table. `known`: entries that are not verified again.
        `operators`: the public keys of the operators by name; None in a swarm without keys. An
        entry without a valid signature is left out. If such an entry names one of `operators`, the
        entry is forged, and the check ends.
        """
        new = [entry for entry in decode_table(blob) if entry not in known]
        trusted: list[Entry] = []
        for entry in new:
            if self._state.is_trusted(entry):
                trusted.append(entry)
                continue
            is_forged = operators is not None and entry.manifest.issuer in operators
            if is_forged:
                return _CheckedTable(trusted, len(new), has_false_signature=True)
        return _CheckedTable(trusted, len(new), has_false_signature=False)

    def _on_code(self, robot: str, entry: Entry, blob: Blob, reason: str) -> None:
        if blob is None:
            log.info("%s is not pulled yet: %s", entry.manifest.label, reason)
        elif not self._store.is_busy:
            self._on_taken(robot, entry)
            self._store.take(entry, blob, robot)
