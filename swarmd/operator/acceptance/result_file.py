"""The results of an acceptance test: `acceptance.json` in a folder, and the one file that remains.

The folder grows while the test runs, so that the test can go on. The file is a zip of the folder
with a report and the schema of `acceptance.json`. Names of hosts and users, and addresses, are
masked in the file (`redaction.py`), not in the folder.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from swarmd.core.errors import ConfigError
from swarmd.core.files import read_member, read_regular, whole_file
from swarmd.daemon.recording.head import RecordingHead, digest_of
from swarmd.operator.acceptance.redaction import Mask, masked_recording
from swarmd.operator.acceptance.step import Step
from swarmd.operator.acceptance.steps import NOT_SHOWN_YET
from swarmd.operator.acceptance.verdict import Result, Verdict

RECORD = "acceptance.json"
SCHEMA = "acceptance.schema.json"
REPORT = "report.html"
RECORDINGS = "recordings"
MAX_AGE = 86400.0
"""s after which a pass lets the robot move no longer: wheels, floor and load have changed."""
MAX_RECORD = 2_000_000
"""Bytes of an `acceptance.json`, which may come from a stranger."""


class StepResult(Struct, frozen=True, kw_only=True):
    """A step with its verdict.

    - `moves`: the announced bounds; empty: nothing moves.
    - `shows`: what no robot has shown yet, and this step would show on a robot that has it.
    - `at`: when it was judged, in s since 1970. `subject`: what was tested, see `subject_of`.
    """

    id: str
    name: str
    why: str
    verdict: Verdict
    prepare: str = ""
    moves: str = ""
    shows: tuple[str, ...] = ()
    recordings: tuple[str, ...] = ()  # names of files
    at: float = 0.0
    subject: dict[str, str] = {}


class AcceptanceRecord(Struct, frozen=True, kw_only=True):
    """An acceptance test of one robot.

    - `began`: the day, in UTC. `versions`: of the programs, by name.
    - `is_whole`: every step was asked. `private`: words that are masked in the file.
    - `subject`: what is tested since the test last went on, see `subject_of`.
    """

    robot: str
    platform: str
    driver: str
    began: str
    versions: dict[str, str] = {}
    is_whole: bool = False
    steps: tuple[StepResult, ...] = ()
    private: tuple[str, ...] = ()
    subject: dict[str, str] = {}
    kind: str = "Acceptance"
    apiVersion: str = "swarm/v1"

    @property
    def verdicts(self) -> dict[str, Verdict]:
        """The verdicts by step."""
        return {step.id: step.verdict for step in self.steps}

    def verdicts_on(self, steps: Sequence[Step], now: float) -> dict[str, Verdict]:
        """The verdicts by step, without those that let the robot move and do not count any more.

        A verdict lets the robot move if a step with a motion needs it. It counts for MAX_AGE, and
        for the subject of this record alone. `now`: s since 1970.
        """
        gates = {id for step in steps if step.motion is not None for id in step.needs}
        return {
            one.id: one.verdict
            for one in self.steps
            if one.id not in gates
            or (one.subject == self.subject and 0.0 <= now - one.at <= MAX_AGE)
        }

    @property
    def counts(self) -> dict[Result, int]:
        """The number of steps by result."""
        results = [step.verdict.result for step in self.steps]
        return {result: results.count(result) for result in Result}

    @property
    def headline(self) -> str:
        """The verdict on the robot in one line."""
        counts = self.counts
        failures = [step.id for step in self.steps if step.verdict.result is Result.FAIL]
        numbers = ", ".join(f"{count} {result}" for result, count in counts.items())
        open_part = "" if self.is_whole else "; not all steps were asked"
        verdict = f"FAIL ({', '.join(failures)})" if failures else "no failure"
        return f"{verdict}: {numbers}{open_part}"


def subject_of(head: RecordingHead) -> dict[str, str]:
    """What a test of the robot with this head is about: all that a verdict may depend on."""
    platform = head.identity.platform
    setup = head.identity.setup
    return {
        "robot": head.identity.robot,
        "swarm": head.swarm,
        "platform": digest_of(platform),
        "driver": setup.driver,
        "base": setup.base,
    }


def record_for(folder: Path, new: AcceptanceRecord) -> AcceptanceRecord:
    """The record with which a test of the subject of `new` goes on in a folder.

    `new` itself without a record there; ConfigError if the folder has that of another robot.
    """
    if not (folder / RECORD).exists():
        return new
    found = read_record(folder)
    before = {"robot": found.robot, **found.subject}
    for name in ("robot", "swarm"):
        if (known := before.get(name)) not in (None, wanted := new.subject[name]):
            raise ConfigError(
                f"{folder}: it has the results of {name} {known}, and {name} {wanted} is tested;"
                " give another --folder"
            )
    return msgspec.structs.replace(
        found, subject=new.subject, platform=new.platform, driver=new.driver
    )


def result_of(
    step: Step,
    verdict: Verdict,
    recordings: Sequence[str],
    at: float = 0.0,
    subject: Mapping[str, str] | None = None,
) -> StepResult:
    """The record of a step, judged at `at` s since 1970; `recordings`: the names of its files."""
    return StepResult(
        id=step.id,
        name=step.name,
        why=step.why,
        verdict=verdict,
        prepare=step.prepare,
        moves="" if step.motion is None else step.motion.text,
        shows=NOT_SHOWN_YET.get(step.id, ()),
        recordings=tuple(recordings),
        at=at,
        subject=dict(subject or {}),
    )


def with_step(
    record: AcceptanceRecord, result: StepResult, order: Sequence[str]
) -> AcceptanceRecord:
    """The record with a step; an earlier verdict on this step is replaced. `order`: of the ids."""
    known = {one.id: one for one in record.steps} | {result.id: result}
    ids = [*order, *(id for id in known if id not in order)]
    return msgspec.structs.replace(record, steps=tuple(known[id] for id in ids if id in known))


def recordings_in(folder: Path, step: str) -> list[Path]:
    """The recordings of a step."""
    return sorted((folder / RECORDINGS).glob(f"{step}-*.mcap"))


def write_record(folder: Path, record: AcceptanceRecord) -> None:
    """Write the record to its folder, whole or not at all."""
    with whole_file(folder / RECORD) as partial:
        partial.write_bytes(msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n")


def read_record(path: Path) -> AcceptanceRecord:
    """The record in a folder or in a file; ConfigError if there is none of this version."""
    try:
        if path.is_dir():
            data = read_regular(path / RECORD, MAX_RECORD)
        else:
            data = read_member(path, RECORD, MAX_RECORD)
        return msgspec.json.decode(data, type=AcceptanceRecord)
    except (OSError, ValueError, RecursionError) as error:
        fault = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(f"{path}: no result of an acceptance test: {fault}") from error


def schema() -> Mapping[str, Any]:
    """The JSON schema of `acceptance.json`."""
    return msgspec.json.schema(AcceptanceRecord)


def write_file(folder: Path, path: Path, report: str, mask: Mask) -> None:
    """Write the one file from a folder; `report`: its page. `mask` hides what is private.

    OSError if the disk fails; the incomplete file is then removed.
    """
    record = read_record(folder)
    shown = msgspec.structs.replace(record, private=())
    texts = {
        RECORD: msgspec.json.format(msgspec.json.encode(shown), indent=1),
        SCHEMA: msgspec.json.format(msgspec.json.encode(schema()), indent=1),
        REPORT: report.encode(),
        **{one.name: read_regular(one) for one in sorted(folder.glob("*.yaml"))},
    }
    with whole_file(path) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in texts.items():
            file.writestr(name, mask.apply(data))
        for one in sorted((folder / RECORDINGS).rglob("*.mcap")):
            file.writestr(f"{RECORDINGS}/{one.name}", masked_recording(one, mask))
