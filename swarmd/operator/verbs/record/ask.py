"""Copies files of robots to this machine: recordings, and what robots keep of an incident.

For `swarmctl`, the page and Python: no click, no printing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmd.core.errors import CodecError, NetworkError, RequestError, SwarmError
from swarmd.operator.session.exit_codes import APPLIED, NO_TARGET, PARTIAL, TIMEOUT
from swarmd.operator.session.session import ASK_TIME

if TYPE_CHECKING:
    from swarmd.core.verbs import RecordingFile
    from swarmd.daemon.recording.fetch import Ask, Copy, Source
    from swarmd.operator.session.session import Session

OnBytes = Callable[[str, str, int, int], None]
"""Robot and file, bytes that came, and bytes of the whole."""


class FetchedFile(NamedTuple):
    """A copy. `state`: `whole`, `so far` (the robot still writes the file), or the fault."""

    robot: str
    path: Path
    size: int  # bytes
    state: str


@dataclass(frozen=True, slots=True)
class Fetched:
    """The copies of a fetch, each in a folder of its robot below `folder`.

    `missing`: robots of which nothing came, or not all of it. True only if `exit_code` is 0: all
    came.
    """

    folder: Path
    files: tuple[FetchedFile, ...]
    missing: tuple[str, ...]
    exit_code: int

    def __bool__(self) -> bool:
        return self.exit_code == APPLIED

    def as_json(self) -> dict[str, Any]:
        """The content of the JSON document."""
        rows = [
            {"robot": one.robot, "path": str(one.path), "state": one.state} for one in self.files
        ]
        return {"files": rows, "missing": list(self.missing)}


def ask_of(session: Session) -> Ask:
    """What asks one robot a query of a session."""

    def ask(robot: str, name: str, payload: bytes) -> bytes | None:
        return session.operator.ask(robot, name, payload, timeout=session.timeout or ASK_TIME)

    return ask


def fetch_files(
    session: Session,
    files: Mapping[str, Sequence[RecordingFile]],
    failed: Iterable[str],
    folder: Path,
    source: Source | None = None,
    on_bytes: OnBytes = lambda robot, file, received, size: None,
) -> Fetched:
    """Copy files of robots into `folder`; a copy that was interrupted continues where it ended.

    `failed`: the robots that have failed before. `source`: None for recordings. RequestError if
    there is nothing to fetch; SwarmError if a copy cannot be written, or if the caller no longer
    waits: what came is kept.
    """
    on_piece = _unless_cancelled(session, on_bytes)
    ask = ask_of(session)
    rows: list[FetchedFile] = []
    missing = list(failed)
    for robot, listed in files.items():
        copies, is_complete = _copied(session, ask, robot, listed, folder, source, on_piece)
        for copy in copies:
            state = copy.fault or ("whole" if copy.is_whole else "so far")
            rows.append(FetchedFile(robot, copy.path, copy.size, state))
        if not is_complete:
            missing.append(robot)
    if not rows and not missing:
        raise RequestError(f"{', '.join(files)}: no recording to fetch", NO_TARGET)
    return Fetched(folder, tuple(rows), tuple(missing), code_of_fetch(files, missing))


def _unless_cancelled(session: Session, on_bytes: OnBytes) -> OnBytes:
    """As `on_bytes`; SwarmError once the caller no longer waits."""

    def on_piece(robot: str, file: str, received: int, size: int) -> None:
        if session.is_cancelled():
            raise SwarmError("the fetch was cancelled; what came is kept, and a fetch continues it")
        on_bytes(robot, file, received, size)

    return on_piece


def code_of_fetch(answered: Iterable[str], failed: Sequence[str]) -> int:
    """PARTIAL if a robot failed, or TIMEOUT if no robot answered; else APPLIED."""
    if not failed:
        return APPLIED
    return PARTIAL if list(answered) else TIMEOUT


def _copied(
    session: Session,
    ask: Ask,
    robot: str,
    files: Sequence[RecordingFile],
    folder: Path,
    source: Source | None,
    on_bytes: OnBytes,
) -> tuple[list[Copy], bool]:
    """Copy files of a robot into `folder`; the copies, and True if no file is missing."""
    from swarmd.daemon.recording.fetch import RECORDING, check_sizes, fetch, note_clock

    copies: list[Copy] = []
    try:
        check_sizes(robot, files, folder, source or RECORDING)
        note_clock(ask, robot, folder)  # the offset of its clock, for `record merge`
        for file in files:
            progress = partial(on_bytes, robot, file.name)
            copy = fetch(ask, robot, file, folder, progress, source=source or RECORDING)
            copies.append(_readable(copy))
    except NetworkError as error:  # the remaining files are left out
        session.tell(str(error))
        return copies, False
    except OSError as error:
        raise SwarmError(
            f"{folder}: {error.strerror}; what came is kept; make room and fetch again"
        ) from error
    return copies, not any(copy.fault for copy in copies)


def _readable(copy: Copy) -> Copy:
    """The copy; of an incident the recording that is written beside it."""
    from swarmd.daemon.recording.incident_file import SUFFIX, to_recording

    if not copy.is_whole or copy.path.suffix != SUFFIX:
        return copy
    try:
        return copy._replace(path=to_recording(copy.path))
    except CodecError as error:
        return copy._replace(fault=str(error))
