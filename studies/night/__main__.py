"""Makes the tables of the pages from one commit: `python -m studies.night [JOB ...]`, `make night`.

A job runs unless its results were made from the same sources; each ends with its file and its parts
of pages. After a kill the same command goes on. `--plan` shows the jobs with their CPU-minutes, and
for named jobs their sources and which of them have changed. With `--on ADDRESS` a Dask cluster does
the runs of the jobs that go through `simulate`; the others run here.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import date

from benchmarks.table import markdown
from studies.night.jobs import JOBS, STORED_RUNS, Job, PatternJob, keep, share, stored_runs
from studies.night.pages import write_parts
from studies.night.sources import ROOT, changed_since, commit_of, forget
from studies.outcomes.outcome import software
from swarmd.core.errors import SwarmError, unknown
from swarmd.core.files import lock_file
from swarmd.core.pin import restart_pinned

LOGS = ROOT / "build" / "night"
OVERVIEW = "night"
"""The part of docs/evidence/README.md with all jobs."""


def state(job: Job) -> str:
    """Whether the results are of these sources, and else what has changed since."""
    made = job.made
    if made is None:
        return "never made"
    if job.is_kept:
        return "kept"
    changed = changed_since(made.made_with["commit"], job.sources)
    if changed is None:
        return "of a commit that git does not know"
    return f"{len(changed)} files changed" if changed else "made before its sources were known"


def plan(jobs: Sequence[Job], *, is_detailed: bool, is_all: bool = False) -> str:
    """A table of jobs; in detail also the sources of each."""
    rows = [["job", "CPU-minutes", "made on", "commit", "state"]]
    for job in jobs:
        made = job.made.made_with if job.made else {}
        cells = made.get("day", "-"), made.get("commit", "-"), state(job)
        rows.append([job.name, f"{job.estimate:.1f}", *cells])
    left = [job.estimate for job in jobs if is_all or not job.is_kept]
    lines = [markdown(rows), "", f"{len(left)} jobs to do, {sum(left):.0f} CPU-minutes"]
    for job in jobs if is_detailed else ():
        since = job.made.made_with["commit"] if job.made else "HEAD"
        changed = set(changed_since(since, job.sources) or ())
        names = [path.relative_to(ROOT).as_posix() for path in job.sources]
        lines += ["", f"{job.name}: {job.command}, decided by {len(names)} files"]
        lines += [f"  {name}{', changed' * (name in changed)}" for name in names]
    return "\n".join(lines)


def overview() -> list[str]:
    """A table of all jobs and their kept results."""
    rows = [["job", "results", "made on", "commit", "CPU-minutes"]]
    for job in JOBS:
        made, name = job.made.made_with if job.made else None, job.file.relative_to(ROOT).as_posix()
        cells = ["not made by a night yet: the table of the page is older", "-", "-", "-"]
        if made is not None:
            minutes = made.get("cpu_minutes", "-")
            if STORED_RUNS in made:
                minutes += f", without {made[STORED_RUNS]} stored runs"
            cells = [f"[{name}](../../{name})", made["day"], made["commit"], minutes]
        rows.append([job.name, *cells])
    return markdown(rows).splitlines()


def carry_out(job: Job, lock: int, on: str | None = None) -> bool:
    """Run a job, which inherits the descriptor `lock`, and keep its results.

    `on`: the address of a Dask scheduler, whose workers do the runs if the job takes an executor.

    Returns whether it has ended well.
    """
    forget()
    digest, commit = job.digest, commit_of(job.sources)
    before = {one: one.read_bytes() for one in job.written if one.exists()}
    spent = LOGS / f"{job.name}.seconds"
    seconds = float(spent.read_text()) if spent.exists() else 0.0
    begin = _seconds_of_children()
    begun = time.time()
    with (LOGS / f"{job.name}.log").open("a") as log:
        words = [sys.executable, *job.arguments]
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
    if isinstance(job, PatternJob):
        return True
    if done.returncode:
        print(f"{job.name}: its table has a fault", file=sys.stderr)
    origin = {"day": date.today().isoformat(), "commit": commit, "digest": digest}
    origin["cpu_minutes"] = f"{seconds / 60.0:.1f}"
    origin |= stored_runs(begun)
    missing = keep(job, done.stdout, {**software(), **origin})
    for name in missing:
        print(f"{job.name}: no page has a part `<!-- results: {name} -->`", file=sys.stderr)
    return not missing and done.returncode == 0


def _seconds_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m studies.night", description=__doc__)
    parser.add_argument("jobs", nargs="*", metavar="JOB", help="default: all")
    parser.add_argument("--plan", action="store_true", help="show what would be done")
    parser.add_argument("--all", action="store_true", help="also what was made from these sources")
    parser.add_argument(
        "--shard", default="1/1", metavar="K/N", help="the K-th of N parts of the jobs"
    )
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
    bad = 0
    for job in chosen:
        if job.is_kept and not options.all:
            continue
        print(f"{job.name}: some {job.estimate:.1f} CPU-minutes, {job.command}", flush=True)
        if options.on is not None and not job.takes_executor:
            print(f"{job.name}: runs here, since it does not go through `simulate`", flush=True)
        bad += not carry_out(job, lock, options.on)
        write_parts({OVERVIEW: "\n".join(overview())})
    return 1 if bad else 0


if __name__ == "__main__":
    restart_pinned()  # and so all jobs, whose results are equal on any x86-64
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # a reader such as head ends it
    try:
        raise SystemExit(main())
    except SwarmError as error:
        raise SystemExit(f"error: {error}") from error
