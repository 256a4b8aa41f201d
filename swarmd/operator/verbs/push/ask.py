"""Pushes a pattern to robots, for `swarmctl`, the page and Python: no click, no printing."""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from msgspec.structs import asdict
from msgspec.structs import replace as with_fields

from swarmd.core.clock import boottime
from swarmd.core.errors import CodecError, ConfigError, PluginError, RequestError, SwarmError
from swarmd.core.files import as_text, read_regular
from swarmd.core.keys import check_id
from swarmd.core.pattern_manifest import (
    MAX_CODE,
    PatternManifest,
    Signed,
    encode_manifest,
    read_entry,
)
from swarmd.core.verbs import PLUGINS, PushedPatternReport, PushedPatternsReply, PushRequest
from swarmd.link.keys.content_signature import Purpose, is_signed_by, sign
from swarmd.operator.session.exit_codes import PARTIAL, TIMEOUT
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.session import ask_robots, in_reach
from swarmd.operator.session.targets import check_time
from swarmd.operator.texts.values import printable
from swarmd.operator.verbs.push import words
from swarmd.operator.verbs.run.ask import goal_targets
from swarmd.operator.verbs.run.canary import choose_canaries
from swarmd.plugins import PATTERN_FILE, has_modules, parsed, pattern_file, pattern_name

if TYPE_CHECKING:
    from swarmd.link.keys.identity import Identity
    from swarmd.link.settings import NetworkSettings
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.session import Session, TargetedView
    from swarmd.operator.session.targets import Targets

PIECE = 32768  # bytes of code in one request
MAX_GENERATION = 2**32 - 1  # version number of a manifest
PUSH_TIMEOUT = 15.0  # s: a trial on a robot may take 10
CANARY_TIME = 90.0  # s: a version is held after 60 s of runs
LOOK_PERIOD = 0.5  # s between two queries of the canaries
TELL_PERIOD = 10.0  # s between two lines about the wait for canaries
# characters in a manifest
MAX_NAME = 63
MAX_VERSION = 32
DIGEST_LENGTH = 12  # characters of the hash in a report of pushed patterns
_USED = ("provisional", "held")  # the standings of code that the next run uses


class Source(NamedTuple):
    """The content of a file to be pushed."""

    name: str
    kind: Literal["file", "wheel"]
    version: str
    value: str
    code: bytes

    @property
    def digest(self) -> str:
        """The hash of the code as robots report it, shortened."""
        return hashlib.sha256(self.code).hexdigest()[:DIGEST_LENGTH]


@dataclass(frozen=True, slots=True)
class Push:
    """A push as it was asked for.

    `version`: shown beside the hash; empty: that of the wheel. `canary`: the robot, or the number
    of robots, that get the code first; `canary_time`: the longest wait in s until they hold it,
    CANARY_TIME by default. `replace`: also in place of a pattern that a robot has itself. `rerun`:
    a robot that runs the pattern stops, and runs it again with the new code.
    """

    source: Source
    version: str = ""
    canary: int | str | None = None
    canary_time: float | None = None
    replace: bool = False
    rerun: bool = False

    def check(self) -> None:
        """ConfigError for a wrong value."""
        if not isinstance(self.version, str):
            raise ConfigError(f"version is {self.version!r}; expected a text")
        for name in ("replace", "rerun"):
            if not isinstance(getattr(self, name), bool):  # a text such as "no" would count as True
                raise ConfigError(f"{name} is {getattr(self, name)!r}; expected True or False")
        check_time("canary_time", self.canary_time)
        if self.canary is None and self.canary_time is not None:
            raise ConfigError("canary_time: expected canary, too")


class PushOutcome(Outcome, frozen=True):
    """The outcome of a push: of each robot whether it has the code now, and since when.

    `applied` robots have the code: those in `taken` since this push, those in `had` had it already.
    `refused` and `failed` robots keep what they had; `replies` says why. `missing` did not answer,
    and may have the code. `pattern`, `digest`: the name of the pattern, and the hash of the code as
    `swarmctl plugin list` shows it. `canary`: how the canaries did with the new code, in words.
    """

    pattern: str = ""
    digest: str = ""
    had: tuple[str, ...] = ()
    canary: str = ""

    @property
    def taken(self) -> tuple[str, ...]:
        """The robots that have the code since this push."""
        return tuple(robot for robot in self.applied if robot not in self.had)


def read_source(path: Path) -> Source:
    """The content of a .py, a wheel, or the folder of a pattern.

    PluginError or ConfigError if it cannot be pushed, OSError if it cannot be read.
    """
    file = pattern_file(path)
    name = pattern_name(file)
    is_folder = file.name == PATTERN_FILE and (path != file or has_modules(file))
    if not is_folder:
        _check_kind(file)
        return source_of(read_regular(file), file, name, label=str(path))
    from swarmd.pattern_host.wheel import packed_folder

    check_id(name, f"{file.parent}: the pattern's name")
    code = packed_folder(file.parent, name)
    return _wheel(_checked_size(code, file.parent), str(path))


def source_of(code: bytes, file: Path, name: str = "", *, label: str = "") -> Source:
    """The content `code` of a .py or a wheel of the name `file`; it need not be on this machine.

    `name`: of the pattern in a .py, by default the file's own. `label`: the file in errors about a
    wheel. PluginError or ConfigError if it cannot be pushed.
    """
    _check_kind(file)
    _checked_size(code, file)
    if file.suffix == ".whl":
        return _wheel(code, label or str(file))
    name = name or file.stem
    check_id(name, f"{file}: the pattern's name")
    parsed(code, file)
    return Source(name, "file", "", "", code)


def _check_kind(file: Path) -> None:
    if file.suffix not in (".py", ".whl"):
        raise PluginError(f"{file}: expected a .py, a .whl, or the folder of a pattern")


def _wheel(code: bytes, label: str) -> Source:
    from swarmd.pattern_host.wheel import inspect_wheel

    found = inspect_wheel(code, label)
    return Source(found.name, "wheel", found.version, found.value, code)


def _checked_size(code: bytes, path: Path) -> bytes:
    """The code; PluginError if it has too many bytes to be sent."""
    if len(code) > MAX_CODE:
        raise _too_large(path, len(code))
    return code


def _too_large(path: Path, size: int) -> PluginError:
    return PluginError(f"{path} has {size} bytes; at most {MAX_CODE} (1 MiB) are sent")


def source_at(file: str | Path) -> Source:
    """As `read_source`; ConfigError in one line whatever the fault."""
    if not isinstance(file, str | Path):
        raise ConfigError(f"file is {file!r}; expected the path of a pattern")
    with _in_one_line():
        return read_source(Path(as_text(file)))


def source_named(name: str, code: bytes, size: int) -> Source:
    """The content of a file that another machine sent; ConfigError in one line for a fault.

    `name`: of the file. `size`: bytes of the file there, of which more than MAX_CODE are not sent.
    """
    with _in_one_line():
        path = Path(as_text(name).replace("\0", " "))
        if size > MAX_CODE:
            raise _too_large(path, size)
        if len(code) != size:
            raise PluginError(f"{path}: {len(code)} of {size} bytes came; choose the file again")
        return source_of(code, path)


@contextmanager
def _in_one_line() -> Iterator[None]:
    """In the block a fault of a file becomes a ConfigError of one line, as swarmctl prints it."""
    try:
        yield
    except UnicodeEncodeError as error:  # the name of a file in a folder
        as_text(error.object)
        raise
    except OSError as error:
        cause = error.strerror or str(error)
        text = cause if error.filename is None else f"{error.filename}: {cause}"
        raise ConfigError(_shown(text)) from error
    except SwarmError as error:
        raise ConfigError(_shown(str(error))) from error


def _shown(text: str) -> str:
    """The text of an error as swarmctl prints it: in one line, without control characters."""
    return printable(" ".join(text.split()))


def check_keys(settings: NetworkSettings, identity: Identity | None) -> None:
    """ConfigError in a swarm whose robots take no code, since it has no keys."""
    if identity is None and settings.profile != "dev":
        raise ConfigError(
            "without keys robots take code in profile dev only; see `swarmctl keys --help`"
        )


def push_to(push: Push, targeted: TargetedView, targets: Targets) -> PushOutcome:
    """Push to the targets. Errors as of `check_keys`, `choose_canaries` and `carry_out`."""
    check_keys(targeted.operator.settings, targeted.operator.identity)
    canaries = () if push.canary is None else choose_canaries(push.canary, targeted.names)
    return carry_out(push, targeted, targets, canaries)


def carry_out(
    push: Push, targeted: TargetedView, targets: Targets, canaries: Collection[str]
) -> PushOutcome:
    """Push to the robots of `targeted`; with canaries first to these, and wait until they hold it.

    `targets`: as typed, which robots that join later may match. RequestError, before anything is
    sent, if no robot answers. RequestError, with the other robots as they were, if a canary does
    not take the code or returns from it, and if the caller no longer waits for the canaries.
    """
    session = targeted.session
    robots = targeted.names
    source = push.source
    push_targets = goal_targets(targets, robots)
    pusher = Pusher(targeted, source, push.version, replace=push.replace, rerun=push.rerun)
    generation = pusher.next_generation()
    had = pusher.having(robots)
    canary_text = ""
    if canaries:
        limit = push.canary_time or CANARY_TIME
        remaining = tuple(robot for robot in robots if robot not in canaries)
        others = ", ".join(remaining)
        names = ", ".join(canaries)
        session.tell(f"canary: {names}; waits up to {limit:.0f} s until it is held")
        outcome = pusher.push(generation, targets=canaries, robots=canaries)
        if len(outcome.applied) < len(canaries):
            for line in words.faults_of(outcome):
                session.tell(line)
            raise _canary_failure(f"canary: {outcome.line}", remaining)
        try:
            canary_text = await_canary(session, source, canaries, remaining, limit)
        except (KeyboardInterrupt, SystemExit):
            session.tell(f"{words.way_back(source.name, canaries)}; nothing was sent to {others}")
            raise
        session.tell(f"canary {names} with the new code: {canary_text}; now {others}")
        # The manifest of the canaries has other targets. A greater generation replaces it.
        generation += 1
    outcome = pusher.push(generation, targets=push_targets, robots=robots)
    if canaries:
        session.tell(words.way_back(source.name, sorted({*canaries, *outcome.applied})))
    return PushOutcome(
        **asdict(targeted.counted(outcome)),
        pattern=source.name,
        digest=source.digest,
        had=tuple(sorted(had & {*outcome.applied})),
        canary=canary_text,
    )


def remove_from(targeted: TargetedView, targets: Targets, name: str) -> Outcome:
    """Remove the pushed pattern `name`; errors as of `carry_out`."""
    pusher = Pusher(targeted, None, name=name)
    generation = pusher.next_generation()
    push_targets = goal_targets(targets, targeted.names)
    return pusher.push(generation, targets=push_targets, robots=targeted.names)


def pushed_patterns_of(
    session: Session, view: MembersView, names: Collection[str]
) -> dict[str, PushedPatternsReply]:
    """What robots in reach have, by robot; those that do not answer are left out."""
    return ask_robots(session, in_reach(view, names), PLUGINS)


def differing(reply_by_robot: Mapping[str, PushedPatternsReply]) -> set[tuple[str, str]]:
    """Pairs of robot and name whose hash differs from the most frequent hash of the name."""
    hashes: dict[str, Counter[str]] = {}
    for reply in reply_by_robot.values():
        for report in reply.patterns:
            hashes.setdefault(report.name, Counter())[report.digest] += 1
    return {
        (robot, report.name)
        for robot, reply in reply_by_robot.items()
        for report in reply.patterns
        if report.digest != hashes[report.name].most_common(1)[0][0]
    }


def greatest_of(replies: Iterable[PushedPatternsReply], identity: Identity | None) -> int:
    """The greatest generation (version number) of a pushed pattern that robots know; 0 without any.

    In a secured swarm only manifests that an operator of the roster signed count: a robot that was
    taken over may report any number.
    """
    if identity is None:
        return max((reply.generation for reply in replies), default=0)

    greatest = 0
    for content, signature in {(reply.newest, reply.signature) for reply in replies}:
        try:
            manifest = read_entry(Signed(content, signature)).manifest
        except CodecError:
            continue
        key = identity.roster.operators.get(manifest.issuer)
        if manifest.generation > greatest and key is not None:
            is_signed = is_signed_by(key, Purpose.MANIFEST, content, signature)
            greatest = manifest.generation if is_signed else greatest
    return greatest


class Pusher:
    """Pushes one pattern, or its removal (`source` None), to robots of a look."""

    def __init__(
        self,
        targeted: TargetedView,
        source: Source | None,
        version: str = "",
        *,
        replace: bool = False,
        rerun: bool = False,
        name: str = "",
    ) -> None:
        self._targeted = targeted
        self._operator = targeted.operator
        self._source = source
        self._version = version
        self._replace = replace
        self._rerun = rerun
        self._name = name
        self._before: dict[str, PushedPatternsReply] = {}  # what robots had, by robot

    def next_generation(self) -> int:
        """The generation for a push: greater than the generation of every robot that answers.

        RequestError if no robot answers; ConfigError after the last generation.
        """
        view = self._targeted.view
        self._before = pushed_patterns_of(self._targeted.session, view, view.members)
        if not self._before:
            names = ", ".join(sorted(view.members)) or "any robot"
            text = f"no answer about patterns from {names}; nothing was sent"
            raise RequestError(text, TIMEOUT)
        generation = 1 + greatest_of(self._before.values(), self._operator.identity)
        if generation > MAX_GENERATION:
            raise ConfigError(
                f"a pattern of the last generation, {MAX_GENERATION}, was pushed; nothing can"
                " follow it: revoke the operator who pushed it, or, without keys, remove"
                " `patterns` from the state folders of the robots and restart them"
            )
        return generation

    def having(self, robots: Collection[str]) -> set[str]:
        """The robots that had the code already when `next_generation` asked them."""
        if self._source is None:
            return set()
        found = {robot: _named(self._before.get(robot), self._source.name) for robot in robots}
        return {
            robot
            for robot, report in found.items()
            if report is not None
            and report.digest == self._source.digest
            and report.standing in _USED
        }

    def push(
        self, generation: int, *, targets: Collection[str], robots: Collection[str]
    ) -> Outcome:
        """Push to `robots` in pieces; a robot that refuses a piece gets no further piece.

        `targets`: the robots that may have the pattern, by names, globs and labels; the manifest
        names the targets, also for robots that join later.
        """
        content, signature = self._manifest(tuple(targets), generation)
        code = b"" if self._source is None else self._source.code
        session = self._targeted.session
        # The robots that take the next piece, each with its epoch: the count of the robot's changes
        # that this operator has seen. A robot that has changed since then refuses the piece.
        epoch_by_robot = self._targeted.view.epochs(robots)
        outcome: Outcome | None = None
        # A removal has no code, and is a single empty piece.
        for offset in range(0, max(len(code), 1), PIECE):
            sent = self._operator.request(
                PushRequest,
                epoch_by_robot,
                timeout=session.timeout,
                least_timeout=PUSH_TIMEOUT,
                issued=session.began,
                content=content,
                signature=signature,
                offset=offset,
                data=code[offset : offset + PIECE],
                is_rerun=self._rerun,
            )
            outcome = sent if outcome is None else _joined(outcome, sent)
            # A robot that did not apply this piece gets no further piece.
            epoch_by_robot = {name: epoch_by_robot[name] for name in outcome.applied}
            if not epoch_by_robot:
                break
        assert outcome is not None
        return outcome

    def _manifest(self, targets: tuple[str, ...], generation: int) -> tuple[bytes, bytes]:
        """The encoded manifest of the push, and its signature; b"" for a swarm without keys.

        The manifest names the pattern, its hash, the robots that take it, and the operator. Without
        source code the manifest removes the pattern from robots. `generation`: the version number
        that orders all manifests of the pattern. ConfigError for a manifest that is too large.
        """
        source = self._source
        operator = self._operator
        identity = operator.identity
        # Without an identity: `user@host`, cut to the length of a name in a manifest.
        issuer = operator.name[:MAX_NAME] if identity is None else identity.name
        manifest = PatternManifest(
            swarm=operator.settings.swarm,
            name=self._name if source is None else source.name,
            generation=generation,
            issuer=issuer,
            targets=targets,
            kind="removed" if source is None else source.kind,
        )
        if source is not None:
            manifest = with_fields(
                manifest,
                version=(self._version or source.version)[:MAX_VERSION],
                digest=hashlib.sha256(source.code).digest(),
                size=len(source.code),
                value=source.value,  # the class of the pattern in a wheel, as `module:Class`
                replaces=self._replace,
            )
        try:
            content = encode_manifest(manifest)
        except CodecError as error:
            raise ConfigError(str(error)) from error
        if identity is None:
            return content, b""
        from swarmd.link.keys.private_keys import load_private_key

        return content, sign(load_private_key(identity.key), Purpose.MANIFEST, content)


def _joined(before: Outcome, after: Outcome) -> Outcome:
    """The outcome after two pieces: a refusal of the first stays; silence is no answer."""
    missing = tuple(sorted({*before.missing, *after.missing}))
    known = {**before.replies, **after.replies}
    replies = {robot: reply for robot, reply in known.items() if robot not in missing}
    seconds = before.seconds + after.seconds
    return with_fields(
        after,
        replies=replies,
        missing=missing,
        warnings=(*before.warnings, *after.warnings),
        seconds=seconds,
        reached=before.reached,
    )


def await_canary(
    session: Session,
    source: Source,
    canaries: Collection[str],
    rest: Collection[str],
    limit: float,
) -> str:
    """Wait until the canaries (the first robots with the new code) have tried the code in a run.

    New code is provisional on a robot until the code has run for a minute without a fault; then the
    robot holds the code. The wait ends, and its result is returned in words,

    - once all canaries hold the code,
    - if no canary with provisional code runs the pattern now (a push starts no run),
    - after `limit` s.

    RequestError if a canary does not answer, or has returned to another version, and if the caller
    no longer waits: the robots of `rest` then keep their code.
    """
    operator = session.operator
    began = told = time.monotonic()
    while True:
        view = operator.members(timeout=session.timeout)
        replies = pushed_patterns_of(session, view, canaries)
        if session.is_cancelled():
            way_back = words.way_back(source.name, canaries)
            raise _canary_failure(f"its caller no longer waits; {way_back}", rest)
        provisional_on: list[str] = []
        for robot in canaries:
            report = _named(replies.get(robot), source.name)
            if report is None or report.digest != source.digest:
                fault = words.canary_fault(report, has_answered=robot in replies)
                raise _canary_failure(f"canary {robot} {fault}", rest)
            if report.standing == "provisional":
                provisional_on.append(robot)
        if not provisional_on:
            return "holds it"
        if not any(_runs(view, robot, source.name) for robot in provisional_on):
            return f"loaded, and not tried by a run on {', '.join(provisional_on)}"
        if (now := time.monotonic()) >= began + limit:
            return f"not held yet after {limit:.0f} s, and without a fault"
        if now >= told + TELL_PERIOD:
            told = now
            names = ", ".join(provisional_on)
            session.tell(f"canary {names}: {now - began:.0f} s, without a fault so far")
        time.sleep(LOOK_PERIOD)
        operator.loops.turn(boottime(), LOOK_PERIOD)


def _runs(view: MembersView, robot: str, pattern: str) -> bool:
    member = view.members.get(robot)
    status = None if member is None else member.status
    return status is not None and status.pattern == pattern


def _canary_failure(why: str, rest: Collection[str]) -> RequestError:
    """The failure after which the robots of `rest` keep their code."""
    return RequestError(f"{why}; nothing was sent to {', '.join(rest)}", PARTIAL)


def _named(reply: PushedPatternsReply | None, name: str) -> PushedPatternReport | None:
    rows = () if reply is None else reply.patterns
    return next((report for report in rows if report.name == name), None)
