"""The folder in which the results of an acceptance test gather, and the file that remains."""

from __future__ import annotations

import datetime
import platform as machine
import socket
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from swarmd.core.errors import ConfigError
from swarmd.daemon.recording.reader import read_file
from swarmd.operator.acceptance.html_report import page
from swarmd.operator.acceptance.redaction import Mask
from swarmd.operator.acceptance.result_file import (
    RECORDINGS,
    AcceptanceRecord,
    recordings_in,
    result_of,
    subject_of,
    with_step,
    write_file,
    write_record,
)
from swarmd.operator.acceptance.samples import read_samples
from swarmd.operator.session.targets import operator_name
from swarmd.settings.platforms import platform_names, platform_sources
from swarmd.settings.yamlfile import text_of

if TYPE_CHECKING:
    from swarmd.operator.acceptance.step import Step
    from swarmd.operator.acceptance.verdict import Verdict
    from swarmd.operator.verbs.acceptance.tested_robot import TestedRobot


class Results:
    """The results of a test in a folder, on the disk at once."""

    def __init__(self, folder: Path, record: AcceptanceRecord, steps: Sequence[Step]) -> None:
        self._folder = folder
        self.record = record
        self._steps = steps
        self._write()

    @property
    def known(self) -> dict[str, Verdict]:
        """The verdicts that count now."""
        return self.record.verdicts_on(self._steps, time.time())

    def outdated(self, step: Step) -> str:
        """The step whose pass is too old to let `step` move the robot; empty without one."""
        known = self.known
        return next((id for id in step.needs if id not in known), "")

    def keep(self, step: Step, verdict: Verdict) -> None:
        """Keep the verdict of a step."""
        names = [path.name for path in recordings_in(self._folder, step.id)]
        result = result_of(step, verdict, names, time.time(), self.record.subject)
        self.record = with_step(self.record, result, [one.id for one in self._steps])
        self._write()

    def end(self, *, is_whole: bool) -> None:
        """Note whether all steps were asked, by this dialogue and those before."""
        asked = {step.id for step in self.record.steps}
        is_whole = is_whole and asked >= {step.id for step in self._steps}
        self.record = msgspec.structs.replace(self.record, is_whole=is_whole)
        self._write()

    def _write(self) -> None:
        write_record(self._folder, self.record)


def wanted_steps(steps: Sequence[Step], rows: Sequence[str]) -> list[Step]:
    """The steps that `rows` name, in their order; all without a row.

    A row is a part, such as B, or the id of a step, such as B1; with it come the steps that read
    what it measures. ConfigError if a row names none.
    """
    chosen: set[str] = set()
    for row in rows:
        found = {
            step.id
            for step in steps
            if row in (step.id, step.id[0]) or (len(row) > 1 and step.reads(row))
        }
        if not found:
            raise ConfigError(f"{row!r} is no part or step; parts are A, B, C and D")
        chosen |= found
    return [step for step in steps if not rows or step.id in chosen]


def keep_platform(name: str, path: Path) -> None:
    """Write the platform file with which a test begins; nothing if it is there, or not known."""
    if name in platform_names() and not path.exists():
        _, content = platform_sources(name)[0]
        path.write_text(text_of(content), encoding="utf-8")


def new_record(tested: TestedRobot) -> AcceptanceRecord:
    """A record without steps."""
    setup = tested.head.identity.setup
    platform = tested.head.identity.platform
    status = tested.status()
    versions = {
        "swarmd": setup.version,
        "swarmctl": version("swarmd"),
        "kernels": setup.kernels,
        "python": machine.python_version(),
        "system": machine.platform(),
    }
    return AcceptanceRecord(
        robot=tested.robot,
        platform=platform.name,
        driver=setup.driver,
        began=datetime.datetime.now(datetime.UTC).date().isoformat(),
        versions=versions,
        private=(
            *operator_name().split("@"),
            socket.gethostname(),
            *(() if status is None else (status.host,)),
        ),
        subject=subject_of(tested.head),
    )


def write_report(folder: Path, record: AcceptanceRecord, *, keep_names: bool = False) -> Path:
    """Write the one file beside the folder; its path. `keep_names`: nothing is masked."""
    path = folder.with_name(f"acceptance-{record.robot}-{record.began}.zip")
    recordings = folder / RECORDINGS
    samples = {
        step.id: read_samples(read_file(recordings / name) for name in step.recordings)
        for step in record.steps
        if step.recordings
    }
    write_file(folder, path, page(record, samples), Mask(record.private, is_on=not keep_names))
    return path
