"""Makes the tables of the pages from one commit: `python -m studies.night [JOB ...]`, `make night`.

A job runs unless its table is current; each ends with its parts of pages and the file of its kept
runs. After a kill the same command goes on. `--check` makes no table: it does some kept runs again
of each table whose sources have changed, and says which tables are current. `--plan` shows the jobs
to do with their CPU-minutes, and for named jobs their sources and which of them have changed.
`--runs` does the jobs and writes their kept runs alone: it says whether these give the tables that
stand on the pages. With `--on ADDRESS` a Dask cluster does the runs of the jobs that go through
`simulate`; the others run here. `--check --processor SandyBridge` does the kept runs here and on an
emulated processor (`emulated.py`).
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import date

from benchmarks.table import markdown
from studies.night.check import CURRENT, State, check, look_at, tell_pages
from studies.night.emulated import check_on
from studies.night.jobs import JOBS, STORED_RUNS, Job, PatternJob, keep, share, stored_runs
from studies.night.kept_runs import Found, KeptRun, Made, listed, read_runs, write
from studies.night.pages import write_parts
from studies.night.sources import ROOT, commit_of, forget
from studies.outcomes.outcome import software
from swarmd.core.errors import SwarmError, unknown
from swarmd.core.files import lock_file
from swarmd.core.pin import restart_pinned
from swarmd.sim.experiments.run_list import VARIABLE

LOGS = ROOT / "build" / "night"
OVERVIEW = "night"
"""The part of docs/evidence/README.md with all jobs."""


def plan(jobs: Sequence[Job], *, is_detailed: bool, is_all: bool = False) -> str:
    """A table of the jobs to do; in detail all of `jobs`, with the sources of each."""
    rows = [["job", "CPU-minutes", "made on", "commit", "current at", "state"]]
    looks = {job.name: look_at(job) for job in jobs}
    left = [job for job in jobs if is_all or looks[job.name].state not in CURRENT]
    for job in jobs if is_detailed else left:
        made = job.made or Made()
        cells = made.made_with.get("day", "-"), made.made_with.get("commit", "-"), _current_at(made)
        rows.append([job.name, f"{job.estimate:.1f}", *cells, looks[job.name].text])
    minutes = sum(job.estimate for job in left)
    others = f"; {len(jobs) - len(left)} tables are current" if len(left) < len(jobs) else ""
    lines = [markdown(rows), "", f"{len(left)} jobs to do, {minutes:.0f} CPU-minutes{others}"]
    for job in jobs if is_detailed else ():
        changed = set(looks[job.name].changed or ())
        names = [path.relative_to(ROOT).as_posix() for path in job.sources]
        lines += ["", f"{job.name}: {job.command}, decided by {len(names)} files"]
        lines += [f"  {name}{', changed' * (name in changed)}" for name in names]
    return "\n".join(lines)


def _current_at(made: Made) -> str:
    return made.current.commit if made.current is not None else "-"


def overview() -> list[str]:
    """A table of all jobs: where their tables were made, and where they are current."""
    rows = [["job", "results", "made on", "made at", "current at", "kept runs", "CPU-minutes"]]
    for job in JOBS:
        name = job.file.relative_to(ROOT).as_posix()
        cells = ["not made by a night yet: the table of the page is older", *"-----"]
        if (made := job.made) is not None:
            by = made.made_with
            minutes = by.get("cpu_minutes", "-")
            if STORED_RUNS in by:
                minutes += f", without {by[STORED_RUNS]} stored runs"
            runs = str(len(read_runs(job.name)) or "-")
            link = f"[{name}](../../{name})"
            cells = [link, by["day"], by["commit"], _found_at(made), runs, minutes]
        rows.append([job.name, *cells])
    return markdown(rows).splitlines()


def _found_at(made: Made) -> str:
    if made.changed is not None:
        return f"changed at {made.changed.commit}"
    if not made.is_same and made.runs_with:
        return f"changed at {made.runs_with['commit']}"
    return _current_at(made)


def carry_out(job: Job, lock: int, on: str | None = None, *, is_table: bool = True) -> bool:
    """Run a job, which inherits the descriptor `lock`, and keep its results.

    `on`: the address of a Dask scheduler, whose workers do the runs if the job takes an executor.
    `is_table`: its table is written; else its kept runs alone.

    Returns whether it has ended well.
    """
    forget()
    digest, commit = job.digest, commit_of(job.sources)
    before = {one: one.read_bytes() for one in job.written if one.exists()}
    spent = LOGS / f"{job.name}.seconds"
    listed_in = LOGS / f"{job.name}.{digest}.jsonl"
    seconds = float(spent.read_text()) if spent.exists() else 0.0
    begin = _seconds_of_children()
    begun = time.time()
    with (LOGS / f"{job.name}.log").open("a") as log:
        words = [sys.executable, *(job.arguments if is_table else job.without_table)]
        if on is not None and job.takes_executor:
            words += ["--on", on]
        try:
            done = subprocess.run(
                words,
                cwd=ROOT,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                check=False,
                pass_fds=(lock,),
                env={**os.environ, VARIABLE: str(listed_in)},
            )
        finally:  # also after Ctrl-C
            seconds += _seconds_of_children() - begin
            spent.write_text(f"{seconds:.1f}")
    forget()
    if job.digest != digest:
        for path, content in before.items():
            path.write_bytes(content)
        print(f"{job.name}: its sources changed while it ran; nothing is kept", file=sys.stderr)
        return False
    if done.returncode > job.has_verdict or done.returncode < 0 or not done.stdout.strip():
        print(f"{job.name} failed: see {LOGS / job.name}.log", file=sys.stderr)
        return False
    spent.unlink()
    runs = listed(listed_in)
    listed_in.unlink(missing_ok=True)
    if done.returncode and not isinstance(job, PatternJob):
        print(f"{job.name}: its table has a fault", file=sys.stderr)
    origin = {"day": date.today().isoformat(), "commit": commit, "digest": digest}
    origin["cpu_minutes"] = f"{seconds / 60.0:.1f}"
    made_with = {**software(), **origin, **stored_runs(begun)}
    if not is_table:
        return keep_runs(job, done.stdout, made_with, runs)
    if isinstance(job, PatternJob):
        job.keep_runs_of_table(runs)
        tell_pages(job, job.made or Made())
        return True
    missing = keep(job, done.stdout, made_with, runs)
    for name in missing:
        print(f"{job.name}: no page has a part `<!-- results: {name} -->`", file=sys.stderr)
    return not missing and done.returncode == 0


def keep_runs(job: Job, output: str, made_with: Mapping[str, str], runs: Sequence[KeptRun]) -> bool:
    """Write the file of a job's kept runs alone, and say whether they give the table of the page.

    Returns whether there are runs to keep.
    """
    made = job.made
    if made is None or not runs:
        why = "no night has made its table" if made is None else "it lists no runs"
        print(f"{job.name}: nothing is kept: {why}", flush=True)
        return False
    is_same = job.gives_table(output)
    whole = Found(
        commit=made_with["commit"],
        day=made_with["day"],
        digest=made_with["digest"],
        drawn=len(runs),
        runs=len(runs),
    )
    kept = Made(
        table=job.name,
        command=made.command,
        made_with=made.made_with,
        parts=made.parts,
        runs_with=dict(made_with),
        is_same=is_same,
        current=whole if is_same else None,
    )
    write(kept, runs)
    tell_pages(job, kept)
    text = "which give the table of the page" if is_same else "which give ANOTHER table"
    print(f"{job.name}: {len(runs)} runs are kept, {text}", flush=True)
    return True


def _seconds_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def check_tables(jobs: Sequence[Job], *, is_again: bool) -> int:
    """Print of each table whether it is current; 1 if one has changed.

    `is_again`: as of `check`.
    """
    counts: Counter[State] = Counter()
    for job in jobs:
        look = check(job, is_again=is_again)
        counts[look.state] += 1
        print(f"{job.name}: {look.state.value}: {look.text}", flush=True)
    write_parts({OVERVIEW: "\n".join(overview())})
    print("; ".join(f"{count} {state.value}" for state, count in counts.items()))
    return 1 if counts[State.CHANGED] else 0


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m studies.night", description=__doc__)
    parser.add_argument("jobs", nargs="*", metavar="JOB", help="default: all")
    parser.add_argument("--plan", action="store_true", help="show what would be done")
    parser.add_argument("--all", action="store_true", help="also what was made from these sources")
    parser.add_argument(
        "--shard", default="1/1", metavar="K/N", help="the K-th of N parts of the jobs"
    )
    parser.add_argument("--check", action="store_true", help="which tables are current")
    parser.add_argument("--processor", help="an emulated one for --check: SandyBridge")
    parser.add_argument("--runs", action="store_true", help="write the kept runs, and no table")
    parser.add_argument("--on", metavar="ADDRESS", help="a Dask scheduler: tls://HOST:8786")
    options = parser.parse_args(arguments)
    names = [job.name for job in JOBS]
    for name in options.jobs:
        if name not in names:
            raise SwarmError(unknown("job", name, names))
    chosen = [job for job in JOBS if not options.jobs or job.name in options.jobs]
    number, _, count = options.shard.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise SwarmError(f"--shard {options.shard}: expected K/N, such as 1/4")
    chosen = share(chosen, int(number), int(count))
    if options.plan:
        print(plan(chosen, is_detailed=bool(options.jobs), is_all=options.all))
        return 0
    if options.on is not None:
        from studies.kept import executor_on

        with executor_on(options.on):
            pass  # ConfigError before the first job if no scheduler answers
    LOGS.mkdir(parents=True, exist_ok=True)
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    lock = os.open(LOGS / "lock", os.O_RDWR | os.O_CREAT)
    try:
        if not lock_file(lock, waits=False):
            print(f"{LOGS}: its file system has no locks; begin no second night here", flush=True)
    except BlockingIOError as error:
        text = "another night, or a job of an ended one, runs here: wait, or use another checkout"
        raise SwarmError(f"{ROOT}: {text}") from error
    if options.processor is not None:
        if not options.check:
            raise SwarmError("--processor goes with --check")
        return check_on(options.processor, chosen)
    if options.check:
        return check_tables(chosen, is_again=options.all)
    bad = 0
    for job in chosen:
        if not options.all and not options.runs and job.is_kept:
            continue
        if lacking := job.lacks():
            print(f"{job.name}: left out: {lacking}", flush=True)
            continue
        print(f"{job.name}: some {job.estimate:.1f} CPU-minutes, {job.command}", flush=True)
        if options.on is not None and not job.takes_executor:
            print(f"{job.name}: runs here, since it does not go through `simulate`", flush=True)
        bad += not carry_out(job, lock, options.on, is_table=not options.runs)
        write_parts({OVERVIEW: "\n".join(overview())})
    return 1 if bad else 0


if __name__ == "__main__":
    restart_pinned()  # and so all jobs, whose results are equal on any x86-64
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # a reader such as head ends it
    try:
        raise SystemExit(main())
    except SwarmError as error:
        raise SystemExit(f"error: {error}") from error
