"""`swarmctl plugin push`, `remove` and `list`: the patterns that robots have by the network."""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import click
from msgspec.structs import replace as with_fields

from swarmd.core.clock import boottime
from swarmd.core.errors import CodecError, ConfigError, PluginError
from swarmd.core.files import read_regular
from swarmd.core.keys import check_id, is_id
from swarmd.core.messages import Code
from swarmd.core.pattern_manifest import (
    MAX_CODE,
    PatternManifest,
    Signed,
    encode_manifest,
    read_entry,
)
from swarmd.core.verbs import PLUGINS, PushedPatternReport, PushedPatternsReply, PushRequest
from swarmd.link.keys.content_signature import Purpose, is_signed_by, sign
from swarmd.operator.cli.ask_robots import ask_robots
from swarmd.operator.cli.canary import canaries_of, read_canary
from swarmd.operator.cli.options import EXISTING, CommonOptions, Duration, Failure, common_options
from swarmd.operator.cli.output import fields, print_json, print_table, warn
from swarmd.operator.cli.send import Asked, asking, known_members
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.ask_robots import in_reach
from swarmd.operator.session.exit_codes import PARTIAL, TIMEOUT, code_of_answers
from swarmd.operator.session.session import gap
from swarmd.operator.session.targets import Targets, targets_of
from swarmd.operator.texts.values import NOTHING
from swarmd.operator.verbs.run.ask import goal_targets
from swarmd.plugins import PATTERN_FILE, has_modules, parsed, pattern_file, pattern_name

if TYPE_CHECKING:
    from swarmd.link.keys.identity import Identity
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.outcome import Outcome

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


class Source(NamedTuple):
    """The content of a file to be pushed."""

    name: str
    kind: Literal["file", "wheel"]
    version: str
    value: str
    code: bytes


@click.command("push", epilog="Example: swarmctl plugin push shy.py --all --canary 1")
@click.argument("file", type=EXISTING)
@takes_targets(is_required=True)
@click.option("--version", default="", help="Shown beside the hash [that of the wheel].")
@click.option(
    "--canary",
    metavar="ROBOT",
    help="First to this robot, or to so many; then to the others if all is well.",
)
@click.option(
    "--canary-time",
    type=Duration(),
    default=CANARY_TIME,
    help="How long a canary that runs it may take until it is held [90s].",
)
@click.option("--replace", is_flag=True, help="Also in place of a pattern that a robot has itself.")
@click.option("--rerun", is_flag=True, help="Stop and run it again where it runs.")
@common_options
def push(
    options: CommonOptions,
    file: Path,
    targets: Targets,
    version: str,
    canary: str | None,
    canary_time: float,
    replace: bool,
    rerun: bool,
) -> None:
    """Send the pattern in FILE, a .py, its folder or a wheel, to TARGETS; starts no run.

    At most 1 MiB of pure Python. A folder is sent with all files that it holds. With keys, your
    identity signs the pattern. Each robot tries the code in a process of its own, and the next run
    of the pattern uses the code. The code is provisional until it has run for 60 s without a fault;
    after a fault the robot stands and returns to the version before. Robots that join later and
    match TARGETS get the pattern from other robots.
    """
    read_canary(canary)
    source = read_source(file)
    settings, _, identity = options.network()
    if identity is None and settings.profile != "dev":
        raise ConfigError(
            "without keys robots take code in profile dev only; see `swarmctl keys --help`"
        )
    with asking(options, targets, needs_status=False) as asked:
        robots = asked.names
        # Globs and labels as typed, which robots that join later may match.
        push_targets = goal_targets(targets, robots)
        canaries = () if canary is None else canaries_of(canary, robots)
        pusher = _Pusher(asked, source, version, replace, rerun)
        generation = pusher.next_generation()
        if canaries:
            remaining = tuple(robot for robot in robots if robot not in canaries)
            others = ", ".join(remaining)
            warn(f"canary: {', '.join(canaries)}; waits up to {canary_time:.0f} s until it is held")
            outcome = pusher.push(generation, targets=canaries, robots=canaries)
            if len(outcome.applied) < len(canaries):
                _warn_of_faults(outcome)
                raise _canary_failure(f"canary: {outcome.line}", remaining)
            try:
                result = _await_canary(asked, source, canaries, remaining, canary_time)
            except (KeyboardInterrupt, SystemExit):
                warn(f"{_way_back(source.name, canaries)}; nothing was sent to {others}")
                raise
            warn(f"canary {', '.join(canaries)} with the new code: {result}; now {others}")
            # The manifest of the canaries has other targets. A greater generation replaces it.
            generation += 1
        outcome = pusher.push(generation, targets=push_targets, robots=robots)
        if canaries:
            warn(_way_back(source.name, sorted({*canaries, *outcome.applied})))
        asked.report(outcome)


@click.command("remove", epilog="Example: swarmctl plugin remove shy --all")
@click.argument("name")
@takes_targets(is_required=True)
@common_options
def remove(options: CommonOptions, name: str, targets: Targets) -> None:
    """Remove the pushed pattern NAME from TARGETS; a run of it goes on until it ends."""
    if not is_id(name):
        raise click.UsageError(f"{name!r} is no pattern name; see `swarmctl plugin list`")
    with asking(options, targets, needs_status=False) as asked:
        pusher = _Pusher(asked, None, name=name)
        generation = pusher.next_generation()
        push_targets = goal_targets(targets, asked.names)
        asked.report(pusher.push(generation, targets=push_targets, robots=asked.names))


@click.command("list", epilog="Example: swarmctl plugin list --all")
@takes_targets(is_required=False)
@common_options
def list_pushed(options: CommonOptions, targets: Targets) -> None:
    """List the pushed patterns of TARGETS, or all robots: version, hash and standing.

    `!` marks a pattern whose hash differs from its most frequent hash in the swarm.
    """
    with options.operator() as operator:
        # The labels of robots are in their statuses.
        view = known_members(options, operator, needs_status=bool(targets.labels))
        robots = targets_of(view, targets)
        replies = pushed_patterns_of(options, operator, view, robots)
        missing = [robot for robot in robots if robot not in replies]
        exit_code = code_of_answers(robots, replies)
        differing = _differing(replies)  # pairs (robot, pattern)
        if options.is_json:
            _print_list_json(replies, missing, differing, exit_code)
        else:
            rows = [
                (robot, *_row(pattern), "!" if (robot, pattern.name) in differing else "")
                for robot, reply in replies.items()
                for pattern in reply.patterns
            ]
            header = ("NAME", "PATTERN", "VERSION", "HASH", "STANDING", "FROM", "TEXT", "")
            print_table(header, rows)
        for robot in missing:
            warn(f"no answer: {gap(view, robot)}")
        click.get_current_context().exit(exit_code)


def pushed_patterns_of(
    options: CommonOptions, operator: Operator, view: MembersView, names: Collection[str]
) -> dict[str, PushedPatternsReply]:
    """What robots in reach have, by robot; those that do not answer are left out."""
    return ask_robots(options, operator, in_reach(view, names), PLUGINS)


def _row(report: PushedPatternReport) -> tuple[str, ...]:
    standing = report.standing
    if standing == "provisional" and report.ran:
        standing += f" ({report.ran:.0f} s)"
    origin = f"{report.issuer}, {report.source}" if report.source else report.issuer
    cells = (report.name, report.version, report.digest, standing, origin, report.text)
    return tuple(cell or NOTHING for cell in cells)


def _differing(reply_by_robot: Mapping[str, PushedPatternsReply]) -> set[tuple[str, str]]:
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


def _print_list_json(
    reply_by_robot: Mapping[str, PushedPatternsReply],
    missing: Collection[str],
    marked: Collection[tuple[str, str]],
    code: int,
) -> None:
    robots = {
        robot: [
            {
                **fields(report, "name", "version"),
                "hash": report.digest,
                **fields(report, "pushed", "standing"),
                "ran": round(report.ran, 1),
                **fields(report, "issuer", "generation", "source", "text"),
                "differs": (robot, report.name) in marked,
            }
            for report in reply.patterns
        ]
        for robot, reply in reply_by_robot.items()
    }
    answer = {"robots": robots, "missing": list(missing), "exit_code": code}
    print_json("PushedPatterns", answer)


def read_source(path: Path) -> Source:
    """The content of a .py, a wheel, or the folder of a pattern.

    PluginError or ConfigError if it cannot be pushed.
    """
    file = pattern_file(path)
    name = pattern_name(file)
    is_folder = file.name == PATTERN_FILE and (path != file or has_modules(file))
    if file.suffix == ".whl" or is_folder:
        from swarmd.pattern_host.wheel import inspect_wheel, packed_folder

        if file.suffix == ".whl":
            code = _checked_size(read_regular(file), file)
        else:
            check_id(name, f"{file.parent}: the pattern's name")
            code = _checked_size(packed_folder(file.parent, name), file.parent)
        found = inspect_wheel(code, str(path))
        return Source(found.name, "wheel", found.version, found.value, code)
    if file.suffix != ".py":
        raise PluginError(f"{file}: expected a .py, a .whl, or the folder of a pattern")
    code = _checked_size(read_regular(file), file)
    check_id(name, f"{file}: the pattern's name")
    parsed(code, file)
    return Source(name, "file", "", "", code)


def _checked_size(code: bytes, path: Path) -> bytes:
    """The code; PluginError if it has too many bytes to be sent."""
    if len(code) > MAX_CODE:
        raise PluginError(f"{path} has {len(code)} bytes; at most {MAX_CODE} (1 MiB) are sent")
    return code


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


class _Pusher:
    """Pushes one pattern, or its removal (`source` None), with one operator."""

    def __init__(
        self,
        asked: Asked,
        source: Source | None,
        version: str = "",
        replace: bool = False,
        rerun: bool = False,
        *,
        name: str = "",
    ) -> None:
        self._asked = asked
        self._operator = asked.operator
        self._source = source
        self._version = version
        self._replace = replace
        self._rerun = rerun
        self._name = name

    def next_generation(self) -> int:
        """The generation for a push: greater than the generation of every robot that answers.

        Failure if no robot answers; ConfigError after the last generation.
        """
        options = self._asked.options
        view = self._asked.view
        pushed = pushed_patterns_of(options, self._operator, view, view.members)
        if not pushed:
            names = ", ".join(sorted(view.members)) or "any robot"
            raise Failure(f"no answer about patterns from {names}; nothing was sent", TIMEOUT)
        generation = 1 + greatest_of(pushed.values(), self._operator.identity)
        if generation > MAX_GENERATION:
            raise ConfigError(
                f"a pattern of the last generation, {MAX_GENERATION}, was pushed; nothing can"
                " follow it: revoke the operator who pushed it, or, without keys, remove"
                " `patterns` from the state folders of the robots and restart them"
            )
        return generation

    def push(
        self, generation: int, *, targets: Collection[str], robots: Collection[str]
    ) -> Outcome:
        """Push to `robots` in pieces; a robot that refuses a piece gets no further piece.

        `targets`: the robots that may have the pattern, by names, globs and labels; the manifest
        names the targets, also for robots that join later.
        """
        content, signature = self._manifest(tuple(targets), generation)
        code = b"" if self._source is None else self._source.code
        # The robots that take the next piece, each with its epoch: the count of the robot's changes
        # that this operator has seen. A robot that has changed since then refuses the piece.
        epoch_by_robot = self._asked.view.epochs(robots)
        outcome: Outcome | None = None
        timeout = self._asked.options.timeout
        # A removal has no code, and is a single empty piece.
        for offset in range(0, max(len(code), 1), PIECE):
            sent = self._operator.request(
                PushRequest,
                epoch_by_robot,
                timeout=timeout,
                least_timeout=PUSH_TIMEOUT,
                issued=self._asked.options.began,
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
    """The outcome after two pieces: a robot that refused the first keeps that reply."""
    replies = {**before.replies, **after.replies}
    missing = tuple(sorted({*before.missing, *after.missing}))
    seconds = before.seconds + after.seconds
    return with_fields(
        after,
        replies=replies,
        missing=missing,
        warnings=(*before.warnings, *after.warnings),
        seconds=seconds,
        reached=before.reached,
    )


def _await_canary(
    asked: Asked, source: Source, canaries: Collection[str], rest: Collection[str], limit: float
) -> str:
    """Wait until the canaries (the first robots with the new code) have tried the code in a run.

    New code is provisional on a robot until the code has run for a minute without a fault; then the
    robot holds the code. The wait ends, and its result is returned in words,

    - once all canaries hold the code,
    - if no canary with provisional code runs the pattern now (a push starts no run),
    - after `limit` s.

    Failure if a canary does not answer, or has returned to another version: the robots of `rest`
    then keep their code.
    """
    options = asked.options
    operator = asked.operator
    digest = hashlib.sha256(source.code).hexdigest()[:DIGEST_LENGTH]
    began = told = time.monotonic()
    while True:
        view = operator.members(timeout=options.timeout)
        replies = pushed_patterns_of(options, operator, view, canaries)
        provisional_on: list[str] = []
        for robot in canaries:
            report = _named(replies.get(robot), source.name)
            if report is None or report.digest != digest:
                fault = _canary_fault(report, has_answered=robot in replies)
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
            warn(f"canary {', '.join(provisional_on)}: {now - began:.0f} s, without a fault so far")
        time.sleep(LOOK_PERIOD)
        operator.loops.turn(boottime(), LOOK_PERIOD)


def _way_back(name: str, robots: Collection[str]) -> str:
    """Which robots have the new code of the pattern `name`, and the verbs that take it back."""
    return (
        f"new code of {name} on {', '.join(robots)}; back: push the file before, or"
        f" `swarmctl plugin remove {name} {' '.join(robots)}`"
    )


def _canary_fault(report: PushedPatternReport | None, *, has_answered: bool) -> str:
    """Why a canary does not have the new code; `report`: of the pattern, on this canary."""
    if report is not None and report.text:  # why the new code failed
        return f"returned: {report.text}"
    return "has another version" if has_answered else "does not answer"


def _runs(view: MembersView, robot: str, pattern: str) -> bool:
    member = view.members.get(robot)
    status = None if member is None else member.status
    return status is not None and status.pattern == pattern


def _warn_of_faults(outcome: Outcome) -> None:
    """Warn of each robot that refused a push, failed or did not answer."""
    for name, reply in outcome.replies.items():
        if reply.code is not Code.APPLIED:
            warn(f"{name}: {reply.code}: {reply.text}")
    for name in outcome.missing:
        warn(f"{name}: no answer")


def _canary_failure(why: str, rest: Collection[str]) -> Failure:
    """The failure after which the robots of `rest` keep their code."""
    return Failure(f"{why}; nothing was sent to {', '.join(rest)}", PARTIAL)


def _named(reply: PushedPatternsReply | None, name: str) -> PushedPatternReport | None:
    rows = () if reply is None else reply.patterns
    return next((report for report in rows if report.name == name), None)
