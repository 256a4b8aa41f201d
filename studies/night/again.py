"""Does kept runs again, each line of JSON of the standard input: `again.py PROCESSES`.

Prints a line `{"bits": "..."}` or `{"error": "..."}` for each, in their order. A program by itself,
which computes with the code of the folder in which it starts, so that a check can also use the code
of an earlier commit. Nothing is taken from the store of runs.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from typing import Any

from swarmd.core.errors import SwarmError
from swarmd.sim.experiments.pool import Job, JobResult, run_jobs
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of

Answer = Mapping[str, str]


def main(processes: int) -> None:
    """Answer all lines."""
    answers = sys.stdout
    sys.stdout = sys.stderr  # what a study prints is no answer
    runs = [json.loads(line) for line in sys.stdin]
    found: dict[int, Answer] = {}
    simulated = {number: run for number, run in enumerate(runs) if "scenario" in run}
    found.update(_simulated(simulated, processes))
    for number, run in enumerate(runs):
        if number not in simulated:
            found[number] = _performed(run)
    for number in range(len(runs)):
        print(json.dumps(found[number]), file=answers)


def _simulated(
    runs: Mapping[int, Mapping[str, Any]], processes: int
) -> Iterator[tuple[int, Answer]]:
    jobs = []
    for number, run in runs.items():
        source = run["scenario"]
        try:
            scenario = (
                load_scenario(source, run["set"])
                if isinstance(source, str)
                else scenario_of(source)
            )
        except SwarmError as error:
            yield number, {"error": str(error)}
            continue
        jobs.append(Job(str(number), scenario.effective, run["seed"], None))
    yield from _done(jobs, processes)


def _done(jobs: Sequence[Job], processes: int) -> Iterator[tuple[int, Answer]]:
    with closing(run_jobs(jobs, processes)) as reports:
        for result in reports:
            if isinstance(result, JobResult):
                answer = {"error": result.reason} if result.reason else {"bits": result.bits}
                yield int(result.run), answer


def _performed(run: Mapping[str, Any]) -> Answer:
    """A run of a study's function."""
    from studies.keeper import again

    try:
        return {"bits": again(run["run"], run["task"]).bits}
    except SwarmError as error:
        return {"error": str(error)}


if __name__ == "__main__":
    main(int(sys.argv[1]))
