"""The jobs of a night: programs whose tables and figures pages show."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

from studies.night.kept_runs import KeptRun, Made, file_of, read_made, write
from studies.night.pages import parts_of, table_on_page, write_parts
from studies.night.sources import ROOT, digest_of, sources_of
from studies.outcomes.outcome import STUDIES, patterns_with_rows, roots_of
from studies.outcomes.outcome import Kept as KeptOutcomes
from swarmd.core.errors import SwarmError
from swarmd.sim.experiments.run_store import run_store

STORED_RUNS = "stored_runs"
"""The key of `Made.made_with` with the number of runs that were taken from the store of runs, and
took none of its CPU-minutes; absent without one."""


def stored_runs(begin: float, environ: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The entry STORED_RUNS of what has run since `begin`, Unix time in s; empty without such runs.

    Other programs that use the store at the same time count, too.
    """
    store = run_store(environ)
    taken = 0 if store is None else store.taken_since(begin)
    return {STORED_RUNS: str(taken)} if taken else {}


class Job(Struct, frozen=True):
    """A program that prints tables in Markdown.

    name: of the file of its kept runs (`kept_runs.py`), and of the part of a page that the program
    prints, unless it prints several. arguments: of Python. minutes: the CPU-minutes that it may
    take, before it has been measured. modules: what decides the results beside the program itself.
    has_verdict: the program ends with 1 if its tables are whole and bad. takes_executor: its runs
    may be done by a Dask cluster, with `--on ADDRESS`. variable: the environment variable with a
    folder of sources that are not kept here; the job is left out without it.
    """

    name: str
    arguments: tuple[str, ...]
    minutes: float
    modules: tuple[str, ...] = ()
    has_verdict: bool = False
    takes_executor: bool = False
    variable: str = ""

    def lacks(self, environ: Mapping[str, str] = os.environ) -> str:
        """Why the job cannot run here; empty if it can."""
        if not self.variable or Path(environ.get(self.variable) or "/nowhere").is_dir():
            return ""
        return f"{self.variable} names no folder with the sources of others; set it"

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
        return file_of(self.name)

    @property
    def written(self) -> tuple[Path, ...]:
        """The files of results that the program itself writes."""
        return ()

    @property
    def without_table(self) -> tuple[str, ...]:
        """The arguments with which the program prints its table, and writes none itself."""
        return self.arguments

    def gives_table(self, output: str) -> bool:
        """Whether what the program printed is the table that stands on the pages."""
        parts = parts_of(output, self.name)
        return bool(parts) and all(table_on_page(part) == parts[part] for part in parts)

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
        """What the table was made with; None if no night has made it. SwarmError for a bad file."""
        return read_made(self.name)

    @property
    def is_kept(self) -> bool:
        """Whether the table is current: of these sources, or found so by a check of these."""
        made = self.made
        if made is None:
            return False
        digest = self.digest
        checked = made.current.digest if made.current is not None else ""
        return digest in (made.made_with.get("digest"), checked)

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
        return ROOT / "patterns" / self.name / "outcome.json"

    @property
    def written(self) -> tuple[Path, ...]:
        return self.file, self.file.with_name("page.md")

    @property
    def without_table(self) -> tuple[str, ...]:
        return tuple(word for word in self.arguments if word != "--keep")

    def gives_table(self, output: str) -> bool:
        kept = msgspec.convert(json.loads(self.file.read_bytes()), KeptOutcomes)
        rows = [f"| {' | '.join((self.name, *one.cells))} |" for one in kept.outcomes]
        return output.strip().splitlines()[2:] == rows

    def keep_runs_of_table(self, runs: Sequence[KeptRun]) -> None:
        """Write the runs of the table that the program has just written."""
        table = msgspec.convert(json.loads(self.file.read_bytes()), Made)
        made = Made(table=self.name, command=self.command, made_with=table.made_with)
        write(made, runs)

    @property
    def made(self) -> Made | None:
        """Of the pattern's file, with what checks have found since the runs of this table."""
        if not self.file.exists():
            return None
        try:
            table = msgspec.convert(json.loads(self.file.read_bytes()), Made)
        except ValueError as error:
            text = f"{self.file}: {error}; take it from git, or remove it"
            raise SwarmError(text) from error
        kept = read_made(self.name) or Made()
        if kept.table and any(
            kept.made_with.get(key) != table.made_with.get(key) for key in ("commit", "digest")
        ):
            kept = Made(is_same=False)  # the table was made by hand since
        made = {"table": self.name, "command": self.command, "made_with": table.made_with}
        return msgspec.structs.replace(kept, **made)


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
    return PatternJob(name, arguments, minutes, roots_of(name))


def _study(
    name: str,
    minutes: float,
    *words: str,
    module: str = "",
    has_verdict: bool = False,
    takes_executor: bool = False,
    variable: str = "",
) -> Job:
    arguments = ("-m", f"studies.{module or name}", *words)
    return Job(
        name,
        arguments,
        minutes,
        has_verdict=has_verdict,
        takes_executor=takes_executor,
        variable=variable,
    )


JOBS: Sequence[Job] = (
    _study("robot_hours", 150.0),
    *(
        _outcomes(name)
        for name in sorted(
            {path.stem for path in ROOT.joinpath(*STUDIES.split(".")).glob("[!_]*.py")}
            | {*patterns_with_rows()}
        )
    ),
    _study("paper", 43.0, takes_executor=True),
    _study("paper_exp2", 2.0, takes_executor=True),
    _study("robot_hours_walls_stand", 20.0, "--walls-stand", module="robot_hours"),
    _study("learning", 6.0),
    _study("missions", 14.0, takes_executor=True),
    _study("tuning", 10.0, takes_executor=True),
    _study("benchmark_suite", 85.0, takes_executor=True),
    _study("voting", 60.0),
    _study("faults", 60.0),
    _study(
        "progress",
        10.0,
        "progress",
        "--seeds",
        "20",
        "--duration",
        "120",
        module="safety",
    ),
    _study("fence", 10.0, module="safety.fence", has_verdict=True),
    _study(
        "encounters",
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
        12.0,
        "beside",
        "--keep",
        "docs/evidence/beside.jsonl",
        "--before",
        "docs/evidence/beside_before.jsonl",
        module="safety",
    ),
    _study("held", 3.0, "held", module="safety"),
    _study("tracks", 5.0, "tracks", "--seeds", "20", module="safety"),
    _study("processors", 10.0, "variants", has_verdict=True),
    Job(
        "mutants",
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
    _study("ros_faults", 6.0, module="ros"),
    _study("ros2swarm", 40.0, variable="SWARMD_ROS2SWARM"),
    Job("executors", ("-m", "benchmarks.executors"), 25.0),
    Job(
        "rivals",
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


def keep(job: Job, output: str, made_with: Mapping[str, str], runs: Sequence[KeptRun]) -> list[str]:
    """Write the parts that a job printed into pages, then its runs into their file.

    The file is the last, so that after a kill it never names a table that the pages lack. Returns
    the names of the parts that no page has.
    """
    parts = parts_of(output, job.name)
    made = Made(table=job.name, command=job.command, made_with=dict(made_with), parts=tuple(parts))
    missing = write_parts({part: "\n".join([*parts[part], "", made.origin]) for part in parts})
    write(made, runs)
    return missing
