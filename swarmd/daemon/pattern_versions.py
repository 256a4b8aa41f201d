"""The versions of pushed patterns on a robot: manifests, trust, disk and choice of a version.

`PatternVersions` has the table (all signed manifests of the swarm) and the versions on this robot,
and writes table and versions to disk. `robot/pushed_pattern.py` has the rules by which a version
changes its standing: provisional (new), held (has run for 60 s without a fault) or returned (has
failed; the version before is current again). `PushedRuns` chooses the version for a load by the
pattern host, and counts the seconds of a version's runs. The generation of a load is its number;
the generation of a manifest is the version number that orders the manifests of a pattern.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from msgspec import Struct
from msgspec.structs import replace

from swarmd.core import pattern_manifest
from swarmd.core.bounds import keep_newest
from swarmd.core.errors import ChangedCodeError, CodecError, PluginError
from swarmd.core.events import CodeInput, HostInput, Input, NoteInput
from swarmd.core.host_messages import HostEvent, Load, Loaded, TrialDone
from swarmd.core.messages import Epoch, Reply
from swarmd.core.verbs import PushedPatternReport, PushedPatternsReply, ReloadRequest, Request
from swarmd.daemon.store import CodeRecord, PatternFiles, RecordWriter
from swarmd.link.keys.content_signature import Purpose, is_signed_by
from swarmd.pattern_host.runner import ProcessRunner
from swarmd.plugins import Origin
from swarmd.robot.actions import FailedCode
from swarmd.robot.pushed_pattern import PushedPattern, Version
from swarmd.robot.robot import Robot

log = logging.getLogger(__name__)

Operators = Mapping[str, bytes]
"""The public keys of operators by name."""


class PatternControl:
    """What the handling of pushed patterns calls of robot and daemon, all on the daemon's loop.

    `on_request` hands a request to the robot, `step` hands any other input to the robot. `reply`
    sends the answer to a push. `warn` logs a warning, also among the robot's events.
    """

    def __init__(
        self,
        robot: Robot,
        runner: ProcessRunner,
        *,
        on_request: Callable[[Request], None],
        step: Callable[[Input], None],
        reply: Callable[[Reply], None],
        warn: Callable[[str], None],
    ) -> None:
        self._robot = robot
        self._runner = runner
        self._on_request = on_request
        self._step = step
        self._reply = reply
        self._warn = warn

    def try_code(self, request: ReloadRequest) -> None:
        """Hand a reload request to the robot; the reply reaches `PatternIntake.on_reply`."""
        self._on_request(request)

    def end_trial(self, event: TrialDone) -> None:
        """Hand the end of a trial to the robot, which `PatternIntake.on_event` held back."""
        self._step(HostInput(event))

    def code_changed(self) -> None:
        """Make the next run use a fresh pattern host."""
        self._step(CodeInput())

    def reply(self, reply: Reply) -> None:
        """Answer a push."""
        self._reply(reply)

    def event(self, text: str) -> None:
        """Log a line, also among the robot's events."""
        log.info("%s", text)
        self._step(NoteInput(text))

    def fault(self, text: str) -> None:
        """Log a warning, also among the robot's events."""
        self._warn(text)

    def epoch(self) -> Epoch:
        """The robot's present epoch."""
        return self._robot.epoch

    def labels(self) -> tuple[str, ...]:
        """The robot's present labels."""
        return self._robot.labels

    def own_patterns(self) -> Mapping[str, Origin]:
        """The patterns of packages and of `plugin_dir`: all but pushed patterns."""
        try:
            return self._runner.own_patterns()
        except PluginError:  # the folder is gone; a run is refused with the reason
            return {}


CHANGED = "its file was changed or damaged on the disk"


class Candidate(Struct, frozen=True):
    """A version of a pattern whose code is being tried, and the stage of its trial."""

    id: str  # of the request (a push, or a pull from a peer) that the trial answers
    entry: pattern_manifest.Entry
    version: Version
    is_passed: bool = False  # the trial has succeeded; the version is being written to disk
    is_accepted: bool = False  # the version has been written to disk


class PatternVersions:
    """The pushed patterns of `robot`, in memory and on disk; a thread writes the newest state.

    `operators` returns the public keys of the operators whose code is accepted; None: code needs no
    signature. Patterns of installed packages and of `plugin_dir` belong to the owner of the robot
    and need no signature. `candidate`: the version that is being tried. `pinned`: by pattern name,
    the version with which the last run began.
    """

    def __init__(
        self, files: PatternFiles, robot: str, swarm: str, operators: Callable[[], Operators | None]
    ) -> None:
        self.files = files
        self._writer = RecordWriter(files, lambda text: self.control.fault(text))
        self.robot = robot
        self.swarm = swarm
        self.operators = operators
        self.control: PatternControl  # set by `open`
        self.table: pattern_manifest.Table = ()
        self.versions: dict[str, PushedPattern] = {}
        self.digest = b""
        self.changes = 0  # count of changes of the table or the versions
        self.candidate: Candidate | None = None
        self.pinned: dict[str, Version] = {}
        self._adopting: tuple[pattern_manifest.Entry, Version] | None = None

    # On the disk

    async def open(self, control: PatternControl) -> None:
        """Read and check the state on disk; called once, before the robot may run."""
        self.control = control
        record = await asyncio.to_thread(self.files.read)
        table = pattern_manifest.read_table(record.table)
        versions = record.versions
        if not table and not versions:
            return
        foreign, checked = await asyncio.to_thread(self._check, table, versions)
        self.set_table(tuple(entry for entry in table if entry not in foreign))
        self._tell_of_changed_files(checked)
        self.versions = {name: code.restarted() for name, code in checked.items()}
        for name, code in self.versions.items():
            if code.failed is not None and code.failed != versions[name].failed:
                self.tell_of_return(name, code)
        await self._writer.write(self._record())
        await asyncio.to_thread(self.files.prune, self.in_use())

    def save(self) -> None:
        """Write the present state to the disk soon."""
        self.changes += 1
        self._writer.store(self._record())

    def _record(self) -> CodeRecord:
        """The record to write: the present state, or during `adopt` the adopted state."""
        table = self.table
        versions = dict(self.versions)
        if self._adopting is not None:
            table, versions = self._adopted(*self._adopting)
        return CodeRecord(tuple(entry.signed for entry in table), versions)

    def _adopted(
        self, entry: pattern_manifest.Entry, version: Version
    ) -> tuple[pattern_manifest.Table, dict[str, PushedPattern]]:
        """The state after a removal, or after a trial that `version` passed."""
        versions = dict(self.versions)
        name = entry.manifest.name
        if entry.is_removal:
            versions.pop(name, None)
        else:
            versions[name] = versions.get(name, PushedPattern()).accept(version)
        return pattern_manifest.merged(self.table, [entry]), versions

    def apply(self, entry: pattern_manifest.Entry, version: Version) -> None:
        """Carry out a removal or make a version current; `save` writes it."""
        table, self.versions = self._adopted(entry, version)
        self.set_table(table)

    @property
    def is_adopting(self) -> bool:
        """True while `adopt` waits for the disk."""
        return self._adopting is not None

    async def adopt(
        self, entry: pattern_manifest.Entry, version: Version, is_wanted: Callable[[], bool]
    ) -> str:
        """Write a removal, or a version that passed its trial, to disk; then carry out the change.

        `is_wanted` is called after the write. If `is_wanted` returns False, the write is undone.
        Only one entry is adopted at a time. Returns the reason if nothing has changed; empty on
        success.
        """
        assert self._adopting is None
        self._adopting = entry, version
        try:
            fault = await self._writer.write(self._record())
        finally:
            self._adopting = None
        if fault:
            fault = "it cannot be written to the disk; see the log"
        elif not is_wanted() or entry not in pattern_manifest.merged(self.table, [entry]):
            fault = "another request came while it was written"
        if fault:
            self.save()  # the disk may have the adopted state: overwrite it
        else:
            self.apply(entry, version)
        return fault

    async def close(self) -> None:
        """Wait until the newest state is on disk, or one more try has failed."""
        await self._writer.close()

    def in_use(self) -> set[tuple[str, bytes]]:
        """Names and digests of the code that may be loaded."""
        loadable = {
            (name, version.digest)
            for name, code in self.versions.items()
            for version in (code.current, code.before)
            if version is not None
        }
        return loadable | {(name, version.digest) for name, version in self.pinned.items()}

    # Trust

    async def check_again(self) -> None:
        """Check all code again, after a change of the roster or of a file.

        Code that no operator of the roster signed is not loaded any more.
        """
        versions = dict(self.versions)
        foreign, checked = await asyncio.to_thread(self._check, self.table, versions)
        self.set_table(tuple(entry for entry in self.table if entry not in foreign))
        self._tell_of_changed_files(checked)
        for name, code in checked.items():
            if code != versions[name] and self.versions.get(name) == versions[name]:
                self.versions[name] = code
                self.pinned.pop(name, None)
                if code.failed is not None:
                    self.tell_of_return(name, code)
                self.control.code_changed()
        self.save()

    def _check(
        self, table: pattern_manifest.Table, versions: Mapping[str, PushedPattern]
    ) -> tuple[set[pattern_manifest.Entry], dict[str, PushedPattern]]:
        """In a thread: the entries that are not trusted, and the versions that may be loaded."""
        foreign = {entry for entry in table if not self.is_trusted(entry)}
        return foreign, {name: self._checked(code) for name, code in versions.items()}

    def _checked(self, code: PushedPattern) -> PushedPattern:
        """`code` without damaged versions, and without versions that no operator has signed.

        Damaged code counts as missing, so that it is pulled from another robot.
        """
        current = code.current
        before = code.before
        if before is not None and not (self._is_signed(before) and self._is_whole(before)):
            before = None
        if current is not None and not self._is_signed(current):
            fault = "no operator of the roster has signed it"
            return PushedPattern(current=before, failed=current, fault=fault)
        if current is not None and not self._is_whole(current):
            # No return to `before`: a run of this name means the code that was pushed last.
            fault = f"{CHANGED}: {current.label}"
            return PushedPattern(before=before, fault=fault, is_damaged=True)
        return replace(code, before=before)

    def _tell_of_changed_files(self, checked: Mapping[str, PushedPattern]) -> None:
        for name, code in checked.items():
            if code.is_damaged and code != self.versions.get(name):
                self.control.fault(f"{name}: {code.fault}")

    def _is_signed(self, version: Version) -> bool:
        try:
            return self.is_trusted(pattern_manifest.read_entry(version.signed))
        except CodecError:
            return False

    def _is_whole(self, version: Version) -> bool:
        try:
            manifest = pattern_manifest.read_entry(version.signed).manifest
        except CodecError:
            return False
        return self.files.code(manifest.name, manifest.digest) is not None

    def is_trusted(self, entry: pattern_manifest.Entry) -> bool:
        """True if an operator of the roster signed the entry; takes some 4 ms.

        Without keys True for each entry of this swarm.
        """
        operators = self.operators()
        manifest = entry.manifest
        if manifest.swarm != self.swarm:
            return False
        if operators is None:
            return True
        key = operators.get(manifest.issuer)
        signature = entry.signed.signature
        return key is not None and is_signed_by(key, Purpose.MANIFEST, entry.content, signature)

    # What is here

    def set_table(self, table: pattern_manifest.Table) -> None:
        """Replace the table."""
        self.changes += 1
        self.table = table
        self.digest = pattern_manifest.digest_of(table)

    def wanted(self) -> Mapping[str, pattern_manifest.Entry]:
        """By name: the newest entry that targets this robot, removals included."""
        return pattern_manifest.wanted_by(self.robot, self.control.labels(), self.table)

    def has(self, entry: pattern_manifest.Entry) -> bool:
        """True if the code of an entry is the current code."""
        code = self.versions.get(entry.manifest.name)
        current = None if code is None else code.current
        return current is not None and current.digest == entry.manifest.digest

    def is_taken(self, manifest: pattern_manifest.PatternManifest) -> bool:
        """True if the robot has an own (not pushed) pattern of that name that must stay."""
        if manifest.replaces or manifest.kind == "removed":
            return False
        return manifest.name in self.control.own_patterns()

    def note_failed(self, entry: pattern_manifest.Entry, version: Version, text: str) -> None:
        """Note a failed trial of `version`: the same push is not tried again."""
        name = entry.manifest.name
        self.versions[name] = self.versions.get(name, PushedPattern()).refuse(version, text)
        self.save()
        self.control.event(f"{entry.manifest.label} is refused: {text}")

    def tell_of_return(self, name: str, code: PushedPattern) -> None:
        """Log the return of a pattern from its failed version to the version before."""
        assert code.failed is not None
        to = "nothing pushed" if code.current is None else code.current.label
        self.control.event(f"{name}: returned from {code.failed.label} to {to}: {code.fault}")

    def missing(self) -> list[pattern_manifest.Entry]:
        """The entries that target this robot and whose code this robot lacks.

        An entry with the name of an own pattern is left out, and noted as failed.
        """
        lacking = []
        for name, entry in self.wanted().items():
            if entry.is_removal or not self.versions.get(name, PushedPattern()).lacks(entry):
                continue
            if self.is_taken(entry.manifest):
                text = f"the robot has a pattern {name!r} of its own"
                self.note_failed(entry, Version.of(entry, "another robot"), text)
            else:
                lacking.append(entry)
        return lacking

    def report(self) -> PushedPatternsReply:
        """All pushed patterns, for operators."""
        wanted = self.wanted()
        rows = []
        for name in sorted({*self.versions, *wanted}):
            entry = wanted.get(name)
            code = self.versions.get(name)
            if code is None and entry is not None and entry.is_removal:
                continue
            rows.append(_report(name, entry, code or PushedPattern()))
        newest = self.table[0].signed if self.table else pattern_manifest.Signed(b"")
        return PushedPatternsReply(
            robot=self.robot,
            generation=pattern_manifest.greatest_generation(self.table),
            patterns=tuple(rows),
            newest=newest.content,
            signature=newest.signature,
        )

    def shared_code(self, digest: str) -> bytes | None:
        """The current code with that SHA-256 (hex), None without; called in a thread."""
        for name, code in list(self.versions.items()):
            current = code.current
            if current is not None and current.digest.hex() == digest:
                return self.files.code(name, current.digest)
        return None


def _report(
    name: str, entry: pattern_manifest.Entry | None, code: PushedPattern
) -> PushedPatternReport:
    current = code.current
    manifest = None if entry is None else entry.manifest
    is_missing = entry is not None and not entry.is_removal and code.lacks(entry)
    used = None if current is None else pattern_manifest.read_entry(current.signed).manifest
    shown = used or manifest
    return PushedPatternReport(
        name=name,
        standing="missing" if is_missing else str(code.standing),
        version="" if used is None else used.version,
        digest="" if used is None else used.digest.hex()[:12],
        pushed="" if manifest is None else manifest.digest.hex()[:12],
        ran=0.0 if current is None else current.ran,
        source="" if current is None else current.source,
        issuer="" if shown is None else shown.issuer,
        generation=0 if shown is None else shown.generation,
        text=code.fault,
    )


MAX_LOADS = 8  # last loads whose version is remembered


@dataclass(frozen=True, slots=True)
class LoadedCode:
    """The pushed pattern that a pattern host has loaded."""

    name: str
    digest: bytes


class PushedRuns:
    """The runs of the pushed patterns in `state`."""

    def __init__(self, state: PatternVersions) -> None:
        self._state = state
        self._loads: dict[int, LoadedCode] = {}
        # At the last `advance`: the generation of the run (-1 without a run), and the time in s.
        self._ran_to: tuple[int, float] = (-1, 0.0)

    def overlay(
        self, installed: Mapping[str, Origin], load: Load, is_trial: bool
    ) -> Mapping[str, Origin]:
        """The place of the code (`Origin`) of each pattern, by name, for a load by a pattern host.

        `installed`: the origins of the robot's own patterns, to which this method adds the pushed
        patterns. `is_trial`: the load tries the candidate, a version that was just pushed. Raises
        ChangedCodeError if the pushed code of the load's pattern is damaged.
        """
        origins = dict(installed)
        candidate = self._state.candidate if is_trial else None
        for name, pushed in self._state.versions.items():
            version = pushed.current
            if load.is_restart and not is_trial:
                # The run goes on with the version with which it began.
                version = self._state.pinned.get(name, version)
            if version is not None:
                is_added = self._add(origins, name, version, installed)
                if is_added and not is_trial:
                    self._note_load(load, name, version)
            elif pushed.is_damaged:
                is_candidate_loaded = candidate is not None  # in place of the damaged version
                if name == load.pattern and not is_candidate_loaded:
                    raise ChangedCodeError(f"{pushed.fault}; push it again")
                # An installed pattern of this name is other code than the pushed pattern.
                origins.pop(name, None)
        if candidate is not None:
            self._add(origins, load.pattern, candidate.version, installed)
        return origins

    def _add(
        self,
        origins: dict[str, Origin],
        name: str,
        version: Version,
        installed: Mapping[str, Origin],
    ) -> bool:
        """Add a version to `origins`; False if an installed pattern has this name.

        A manifest that `replaces` may take the place of the installed pattern.
        """
        manifest = pattern_manifest.read_entry(version.signed).manifest
        if name in installed and not manifest.replaces:
            return False
        value, is_file = self._state.files.place(manifest)
        source = f"{manifest.label} of {manifest.issuer}"
        origins[name] = Origin(value, source, is_file, digest=manifest.digest)
        return True

    def _note_load(self, load: Load, name: str, version: Version) -> None:
        state = self._state
        state.pinned[name] = version
        if name != load.pattern:
            return
        keep_newest(self._loads, load.generation, LoadedCode(name, version.digest), MAX_LOADS)
        if self.is_provisional(load.generation) and not state.versions[name].is_running:
            state.versions[name] = state.versions[name].begin()
            state.save()

    def is_provisional(self, generation: int) -> bool:
        """True if that generation loaded the current version, and this version is provisional."""
        loaded = self._loads.get(generation)
        code = None if loaded is None else self._state.versions.get(loaded.name)
        if loaded is None or code is None or code.current is None:
            return False
        return code.is_provisional and code.current.digest == loaded.digest

    def granted(self, event: HostEvent) -> HostEvent:
        """The event to hand to the robot: `event`, without the `scan_delay` of a pushed pattern.

        A `scan_delay` permits late scans without a hold. So only a pattern of the robot's owner (of
        a package or of `plugin_dir`) may state a `scan_delay`.
        """
        if isinstance(event, Loaded) and event.scan_delay and event.generation in self._loads:
            text = "its `scan_delay` does not count, since it was pushed"
            note = f"{event.note}; {text}" if event.note else text
            return replace(event, scan_delay=0.0, note=note)
        return event

    def on_failed(self, failed: FailedCode) -> None:
        """Return from failed provisional code to the version before; the robot has stopped."""
        loaded = self._loads.get(failed.generation)
        if loaded is None or not self.is_provisional(failed.generation):
            return
        code = self._state.versions[loaded.name] = self._state.versions[loaded.name].failed_with(
            failed.text
        )
        self._state.pinned.pop(loaded.name, None)
        self._state.save()
        self._state.tell_of_return(loaded.name, code)

    def advance(self, now: float, generation: int | None, *, is_running: bool) -> None:
        """Count the time of the run for the version that it runs, and end other versions' runs.

        `generation`: the number of the present run or load; None without a run or load.
        """
        last, at = self._ran_to
        running = generation if is_running else None
        self._ran_to = (-1 if running is None else running), now
        loaded = None if generation is None else self._loads.get(generation)
        for name, code in list(self._state.versions.items()):
            is_this = loaded is not None and loaded.name == name
            if code.is_running and not is_this:
                self._state.versions[name] = code.end()
                self._state.save()
            elif is_this and running == last and self.is_provisional(last):
                self._state.versions[name] = ran = code.ran(now - at)
                if not ran.is_provisional:
                    self._state.save()
                    assert ran.current is not None
                    self._state.control.event(f"{ran.current.label} is held")
