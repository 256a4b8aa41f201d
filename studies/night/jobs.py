"""The jobs of a night: programs whose tables and figures pages show."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from studies.night.pages import parts_of, write_parts
from studies.night.sources import ROOT, digest_of, sources_of
from studies.outcomes.outcome import STUDIES, patterns_with_rows, roots_of
from swarmd.core.errors import SwarmError
from swarmd.core.files import write_whole
from swarmd.sim.experiments.run_store import run_store

STORED_RUNS = "stored_runs"
"""The key of `Made.made_with` with the number of runs that were taken from the store of runs, and
took none of its CPU-minutes; absent without one."""


class Made(Struct, frozen=True, kw_only=True):
    """The results of a job in a JSON file.

    `made_with`: the software and the machine, and the keys `day`, `commit`, `digest` of the sources
    and `cpu_minutes`. `parts`: the lines of each part of a page, by its name; a pattern's file has
    the values of its runs in their place.
    """

    command: str = ""
    made_with: dict[str, str]
    parts: dict[str, list[str]] = {}

    def text(self, part: str) -> str:
        """A part of a page: its lines, and how it was made."""
        origin = f"Made on {{day}} with commit {{commit}} by `{self.command}`."
        return "\n".join([*self.parts[part], "", origin.format_map(self.made_with)])


def stored_runs(begin: float, environ: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The entry STORED_RUNS of what has run since `begin`, Unix time in s; empty without such runs.

    Other programs that use the store at the same time count, too.
    """
    store = run_store(environ)
    taken = 0 if store is None else store.taken_since(begin)
    return {STORED_RUNS: str(taken)} if taken else {}


class Job(Struct, frozen=True):
    """A program that prints tables in Markdown.

    name: of the file of results, `folder/name.json`, and of the part of a page that the program
    prints, unless it prints several. arguments: of Python. minutes: the CPU-minutes that it may
    take, before it has been measured. modules: what decides the results beside the program itself.
    has_verdict: the program ends with 1 if its tables are whole and bad. takes_executor: its runs
    may be done by a Dask cluster, with `--on ADDRESS`.
    """

    name: str
    folder: str
    arguments: tuple[str, ...]
    minutes: float
    modules: tuple[str, ...] = ()
    has_verdict: bool = False
    takes_executor: bool = False

    @property
    def command(self) -> str:
        """What repeats the job."""
        return shlex.join(("python", *self.arguments))

    @property
    def roots(self) -> tuple[str, ...]:
        """The modules with whose imports the sources begin."""
        return self.modules or (self.arguments[1], f"{self.arguments[1]}.__main__")

    @property
    def file(self) -> Path:
        """The file of results."""
        return ROOT / self.folder / f"{self.name}.json"

    @property
    def written(self) -> tuple[Path, ...]:
        """The files of results that the program itself writes."""
        return ()

    @property
    def sources(self) -> list[Path]:
        """The files that decide the results."""
        return sources_of(self.roots)

    @property
    def digest(self) -> str:
        """The digest of the sources."""
        return digest_of(self.roots)

    @property
    def made(self) -> Made | None:
        """The kept results; None without a file. SwarmError if it is no such file."""
        if not self.file.exists():
            return None
        # The module json reads numbers that are not finite, too.
        try:
            return msgspec.convert(json.loads(self.file.read_bytes()), Made)
        except ValueError as error:
            text = f"{self.file}: {error}; take it from git, or remove it"
            raise SwarmError(text) from error

    @property
    def is_kept(self) -> bool:
        """Whether the kept results are of these sources."""
        return self.made is not None and self.made.made_with.get("digest") == self.digest

    @property
    def estimate(self) -> float:
        """CPU-minutes: those of the last time, unless it took runs from the store of runs."""
        made = self.made.made_with if self.made else {}
        used = made.get("cpu_minutes")
        if used is None:
            return self.minutes
        return max(self.minutes, float(used)) if STORED_RUNS in made else float(used)


class PatternJob(Job, frozen=True):
    """The outcomes of a pattern, which the study itself keeps."""

    @property
    def file(self) -> Path:
        return ROOT / self.folder / "outcome.json"

    @property
    def written(self) -> tuple[Path, ...]:
        return self.file, self.file.with_name("page.md")


_LONG = {
    "collective_perception": 37.0,
    "foraging": 18.0,
    "one_bit_aggregation": 10.0,
    "vicsek_alignment": 10.0,
    "cooperative_transport": 7.0,
}
"""The CPU-minutes of the patterns that take the longest."""


def _outcomes(name: str) -> Job:
    arguments = ("-m", "studies.outcomes", name, "--keep")
    minutes = _LONG.get(name, 3.0)
    return PatternJob(name, f"patterns/{name}", arguments, minutes, roots_of(name))


def _study(
    name: str,
    folder: str,
    minutes: float,
    *words: str,
    module: str = "",
    has_verdict: bool = False,
    takes_executor: bool = False,
) -> Job:
    arguments = ("-m", f"studies.{module or name}", *words)
    return Job(
        name,
        folder,
        arguments,
        minutes,
        has_verdict=has_verdict,
        takes_executor=takes_executor,
    )


JOBS: Sequence[Job] = (
    _study("robot_hours", "docs/evidence", 150.0),
    *(
        _outcomes(name)
        for name in sorted(
            {path.stem for path in ROOT.joinpath(*STUDIES.split(".")).glob("[!_]*.py")}
            | {*patterns_with_rows()}
        )
    ),
    _study("paper", "docs", 43.0, takes_executor=True),
    _study("paper_exp2", "docs", 2.0, takes_executor=True),
    _study("robot_hours_walls_stand", "docs/evidence", 20.0, "--walls-stand", module="robot_hours"),
    _study("learning", "docs", 6.0),
    _study("missions", "docs", 14.0, takes_executor=True),
    _study("tuning", "docs", 10.0, takes_executor=True),
    _study("benchmark_suite", "docs", 85.0, takes_executor=True),
    _study("voting", "docs", 60.0),
    _study("faults", "docs/evidence", 60.0),
    _study(
        "progress",
        "docs/evidence",
        10.0,
        "progress",
        "--seeds",
        "20",
        "--duration",
        "120",
        module="safety",
    ),
    _study("fence", "docs/evidence", 10.0, module="safety.fence", has_verdict=True),
    _study(
        "encounters",
        "docs/evidence",
        30.0,
        "encounters",
        "--modes",
        "ghost",
        "orca",
        "walls_stand",
        "--first-seed",
        "3000",
        module="safety",
    ),
    _study(
        "beside",
        "docs/evidence",
        12.0,
        "beside",
        "--keep",
        "docs/evidence/beside.jsonl",
        "--before",
        "docs/evidence/beside_before.jsonl",
        module="safety",
    ),
    _study("held", "docs/evidence", 3.0, "held", module="safety"),
    _study("tracks", "docs/evidence", 5.0, "tracks", "--seeds", "20", module="safety"),
    _study("processors", "docs/evidence", 10.0, "variants", has_verdict=True),
    Job(
        "mutants",
        "docs/evidence",
        ("-m", "studies.mutants"),
        60.0,
        (
            "studies.mutants.__main__",
            "swarmd.driver_api.command_gate",
            "swarmd.drivers.ros2.command_credit",
            "swarmd.robot.robot",
            *("tests.robot.test_requests", "tests.robot.test_requests_reload"),
            *("tests.robot.test_issue_time", "tests.robot.test_ticker"),
        ),
        has_verdict=True,
    ),
    _study("ros_faults", "docs", 6.0, module="ros"),
    Job("executors", "docs", ("-m", "benchmarks.executors"), 20.0),
    Job(
        "rivals",
        "benchmarks",
        ("-m", "benchmarks.rivals"),
        20.0,
        (
            "benchmarks.rivals.__main__",
            "benchmarks.rivals.argos_steps",
            "benchmarks.rivals.enki_steps",
            "benchmarks.rivals.irsim_steps",
            "benchmarks.rivals.swarmd_steps",
            "benchmarks.rivals.vmas_steps",
        ),
    ),
)
"""What readers would miss most comes first."""


def share(jobs: Iterable[Job], number: int, count: int) -> list[Job]:
    """The jobs of shard `number` of 1 to `count`, all of which take about the same time.

    Measured times count for nothing: after a kill, and on machines of other shards, the shards must
    be the same.
    """
    some = list(jobs)
    loads = [0.0] * min(count, len(some))
    chosen: list[Job] = []
    for job in sorted(some, key=lambda job: -job.minutes):
        least = loads.index(min(loads))
        chosen += [job] * (least == number - 1)
        loads[least] += job.minutes
    return [job for job in some if job in chosen]


def keep(job: Job, output: str, made_with: dict[str, Any]) -> list[str]:
    """Write the parts that a job printed into pages, then into its file.

    The file is the last, so that after a kill it never has parts that the pages lack. Returns the
    names of the parts that no page has.
    """
    made = Made(command=job.command, made_with=made_with, parts=parts_of(output, job.name))
    missing = write_parts({part: made.text(part) for part in made.parts})
    write_whole(job.file, msgspec.json.format(msgspec.json.encode(made), indent=1) + b"\n")
    return missing
