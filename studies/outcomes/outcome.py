"""An outcome: a number that a pattern has to reach in a swarm, and what its runs reached."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import cache
from itertools import zip_longest
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from studies.night.pages import with_part
from studies.night.sources import commit_of, digest_of, sources_of
from swarmd.core.pin import functions_here, is_pinned
from swarmd.sim.experiments.manifest import PROCESSOR
from swarmd.sim.experiments.outcomes import NAME
from swarmd.sim.experiments.pool import worker_functions
from swarmd.sim.experiments.provenance import made_with
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.statistics import (
    Interval,
    difference_interval,
    mean_interval,
    median_interval,
    ratio_interval,
    wilson,
)

STUDIES = "studies.outcomes.patterns"
"""The package with the modules of patterns, whose rows do not say all."""
OF_ROWS = "studies.outcomes.rows"
"""The module that makes the outcomes of rows."""
ROWS = "swarmd.patterns"
"""The package with the rows of each pattern."""
PATTERNS = Path(__file__).resolve().parents[2] / "patterns"
KEPT = "outcome.json"
"""The outcomes that were kept, beside the pattern."""
PART = "outcomes"
"""The name of the part of a pattern's page."""
MACHINE = (*PROCESSOR, "numpy", "scipy", "mujoco")
"""The keys of `Kept.made_with` for the machine and its libraries of mathematics.

Lockstep repeats bit by bit where they are equal; the processor counts only if a side was not
pinned."""
SHORT_SEED = 1
"""The seed of the short form."""
FEW, UNBOUNDED = 20, "-"
"""So many runs are not few; `Outcome.wanted` of a number without a condition."""
HEAD = ("what", "wanted", "least / median / most, or of all runs (95 %)", "runs", "reached", "from")
STILL = "[robots that never move](../README.md#robots-that-never-move), fewer than twenty runs"
"""The head of a further column of a page: `Kept.still`."""


@dataclass(frozen=True, slots=True)
class Joined:
    """A statistic of all runs with its 95 % interval, and the values of the runs (samples).

    `kind`: the statistic, which the function `<kind>_of` makes. A ratio or difference has two
    samples.
    """

    kind: Literal["mean", "median", "share", "ratio", "difference"]
    value: float
    interval: Interval | None
    samples: tuple[tuple[float, ...], ...]


def mean_of(values: Iterable[float]) -> Joined:
    """The mean of one value of each run."""
    (some,) = samples = (tuple(map(float, values)),)
    return Joined("mean", float(np.mean(some)), mean_interval(np.array(some)), samples)


def median_of(values: Iterable[float]) -> Joined:
    """The median of one value of each run."""
    (some,) = samples = (tuple(map(float, values)),)
    return Joined("median", float(np.median(some)), median_interval(np.array(some)), samples)


def share_of(is_so: Iterable[bool]) -> Joined:
    """The share of runs with a true value."""
    (some,) = samples = (tuple(map(float, is_so)),)
    return Joined("share", float(np.mean(some)), wilson(int(sum(some)), len(some)), samples)


def ratio_of(above: Iterable[float], below: Iterable[float]) -> Joined:
    """The mean of `above` divided by the mean of `below`, two independent samples of runs."""
    samples = tuple(map(float, above)), tuple(map(float, below))
    upper, lower = map(np.array, samples)
    ratio = float(upper.mean() / lower.mean())
    return Joined("ratio", ratio, ratio_interval(upper, lower), samples)


def difference_of(more: Iterable[float], less: Iterable[float]) -> Joined:
    """The mean of `more` minus the mean of `less`, two independent samples of runs."""
    samples = tuple(map(float, more)), tuple(map(float, less))
    larger, smaller = map(np.array, samples)
    difference = float(larger.mean() - smaller.mean())
    return Joined("difference", difference, difference_interval(smaller, larger), samples)


@dataclass(frozen=True, slots=True)
class Outcome:
    """A number that a pattern has to reach, and the values of its runs."""

    pattern: str
    what: str  # the number, in words
    wanted: str  # the condition, as text
    values: tuple[float, ...]  # a value for each run, or the value of `joined`
    is_reached: bool
    source: str  # the origin of the condition
    joined: Joined | None = None  # if the condition is on a statistic of all runs
    of_runs: int = 0  # if each value is of so many runs together, without an interval

    @property
    def shown(self) -> str:
        """The value as text, with its interval; several values as least, median and most.

        "none" without a value in a run.
        """
        if self.joined is not None and self.joined.interval is not None:
            low, high = self.joined.interval
            return f"{self.joined.value:.3g} ({low:.3g} to {high:.3g})"
        some = np.array(self.values)
        if not some.size or np.isnan(some).any():
            return "none"
        if some.size < 2:
            return f"{some[0]:.3g}"
        return f"{some.min():.3g} / {np.median(some):.3g} / {some.max():.3g}"

    @property
    def runs(self) -> int:
        """The number of runs; of two samples, of the smaller sample."""
        samples = (self.values,) if self.joined is None else self.joined.samples
        return self.of_runs or min(map(len, samples))

    @property
    def cells(self) -> tuple[str, ...]:
        """The cells of a row with the columns HEAD."""
        reached = "yes" if self.is_reached else "**no**"
        reached = reached if self.wanted != UNBOUNDED else UNBOUNDED
        runs = f"{self.runs}{' (fewer than twenty)' * (self.runs < FEW)}"
        return self.what, self.wanted, self.shown, runs, reached, self.source

    @property
    def control(self) -> str:
        """The cell of robots that never move."""
        verdict = "reach it: " if self.is_reached else "miss it: "
        return verdict * (self.wanted != UNBOUNDED) + self.shown


class Digits(msgspec.Struct, frozen=True):
    """The values of an outcome; None where a value is not finite."""

    what: str
    values: tuple[float | None, ...]


class Kept(msgspec.Struct, frozen=True):
    """The outcomes of a pattern in a file, with the seeds and the software that gave them.

    `made_with`: `software`, and the keys `day`, `commit`, `digest` (of the sources that decide the
    values) and `cpu_minutes` (that the values took). `short`: the values of the short form
    (`catalog.short_outcomes`), by which a run of the suite shows that the table is old;
    `short_made_with`: the software that gave them, `made_with` if empty. `still`: the outcomes of
    robots that never move (`still.control_of`), in the order of `outcomes`; none if the pattern
    moves no robot.
    """

    pattern: str
    seeds: int
    made_with: dict[str, str]
    outcomes: tuple[Outcome, ...]
    short: tuple[Digits, ...] = ()
    still: tuple[Outcome, ...] = ()
    short_made_with: dict[str, str] = {}

    @property
    def table(self) -> str:
        """The table of a page, with the commit and the command that made it."""
        rows = [list(cells) for cells in (HEAD, ["---"] * len(HEAD))]
        rows += [list(outcome.cells) for outcome in self.outcomes]
        if self.still:
            controls = [STILL, "---", *(outcome.control for outcome in self.still)]
            for cells, control in zip(rows, controls, strict=True):
                cells.insert(-1, control)
        made = "Made on {day} with commit {commit} by `python -m studies.outcomes {0} --keep`."
        lines = [f"| {' | '.join(cells)} |" for cells in rows]
        return "\n".join([*lines, "", made.format(self.pattern, **self.made_with)])

    @property
    def missed(self) -> list[str]:
        """The outcomes that were not reached."""
        return [outcome.what for outcome in self.outcomes if not outcome.is_reached]

    def other_machine(self) -> str | None:
        """What differs between the machine that gave the values and this one, as text; else None.

        Libraries of mathematics choose their code by processor, and Python 3.12 adds numbers in
        another way than 3.11. So the last digits differ, and later all digits of a run.
        """
        return other_machine(self.made_with, software())

    def other_machine_of_short(self, here: Mapping[str, str]) -> str | None:
        """As `other_machine`, of the machine that gave the short form; `here`: `software`."""
        return other_machine(self.short_made_with or self.made_with, here)


def patterns_with_rows() -> list[str]:
    """The patterns that have a file of outcomes."""
    return sorted(path.parent.name for path in PATTERNS.glob(f"*/{NAME}"))


def roots_of(pattern: str) -> tuple[str, ...]:
    """The modules with whose imports the sources of a pattern's outcomes begin.

    Beside them the pattern, its scenario and its rows, by the names that modules in the place of
    the files would have.
    """
    beside = tuple(f"{ROWS}.{pattern}.{name}" for name in ("pattern", "scenario", Path(NAME).stem))
    if Path(__file__).with_name("patterns").joinpath(f"{pattern}.py").is_file():
        return f"{STUDIES}.{pattern}", *beside
    return OF_ROWS, *beside


def other_machine(there: Mapping[str, str], here: Mapping[str, str]) -> str | None:
    """What differs between two machines, each as `software` gives it, as text; else None."""
    series = [made.get("python", "").rpartition(".")[0] for made in (here, there)]
    is_free = here["pinned"] == there.get("pinned") == "yes"
    keys = [key for key in MACHINE if not (is_free and key == "processor")]
    differing = [key for key in keys if here[key] != there.get(key)]
    differing += ["python"] * (series[0] != series[1])
    texts = [f"{key}: {there.get(key, 'unknown')}, here {here[key]}" for key in differing]
    return ", ".join(texts) or None


def digits_of(outcomes: Sequence[Outcome]) -> tuple[Digits, ...]:
    """The values of outcomes as a file has them."""
    found = [Digits(outcome.what, outcome.values) for outcome in outcomes]
    return msgspec.json.decode(msgspec.json.encode(found), type=tuple[Digits, ...])


def other_digits(kept: Sequence[Digits], now: Sequence[Digits]) -> list[str]:
    """A text for each outcome whose values differ from the kept ones in any digit."""
    pairs = zip_longest(kept, now, fillvalue=Digits("no outcome", ()))
    return [f"{new.what}: {new.values}, kept {old.values}" for old, new in pairs if old != new]


def renewal(pattern: str) -> str:
    """What renews the file and the table of a pattern, as text."""
    return f"`python -m studies.outcomes {pattern} --keep` renews the page and {KEPT}"


@cache
def software() -> dict[str, str]:
    """`made_with` of workers and of this process, with the processor as Linux numbers it.

    `pinned` is `no` unless both are pinned: outcomes are computed in both.
    """
    functions = dict(worker_functions())
    if not is_pinned():
        functions |= functions_here()
    return {**made_with(functions), "processor": _processor()}


def _processor() -> str:
    """The first processor's vendor, family and model as Linux numbers them; else its name."""
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.exists() else []
    pairs = [[part.strip() for part in line.split(":", 1)] for line in lines if ":" in line]
    about = dict(reversed(pairs))
    known = [about[key] for key in ("vendor_id", "cpu family", "model") if key in about]
    return " ".join(known) or platform.processor()


def keep(
    pattern: str,
    seeds: int,
    outcomes: Sequence[Outcome],
    short: Sequence[Outcome],
    still: Sequence[Outcome] = (),
    *,
    cpu_minutes: float = 0.0,
    stored_runs: Mapping[str, str] | None = None,
) -> None:
    """Write the outcomes beside the pattern, and their table into the part PART of its page.

    `seeds`: the number of seeds, from 0 on. `short`: the outcomes of the short form. `still`: those
    of robots that never move. `stored_runs`: the entry of `made_with` for runs that were taken from
    the store of runs. The file is written last, so that it never names values that the page
    lacks.
    """
    sources = roots_of(pattern)
    commit, digest = commit_of(sources_of(sources)), digest_of(sources)
    origin = {"day": date.today().isoformat(), "commit": commit, "digest": digest}
    origin |= {"cpu_minutes": f"{cpu_minutes:.2f}", **(stored_runs or {})}
    made = {**software(), **origin}
    kept = Kept(pattern, seeds, made, tuple(outcomes), digits_of(short), tuple(still), software())
    page = PATTERNS / pattern / "page.md"
    page.write_text(with_part(page.read_text(), PART, kept.table))
    (PATTERNS / pattern / KEPT).write_bytes(as_file(kept))


def keep_short(pattern: str, short: Sequence[Outcome]) -> None:
    """Write the values of the short form into the file of a pattern; its table stays as it is.

    The table stays old if it was old: `made_with` does not change.
    """
    file = PATTERNS / pattern / KEPT
    kept = msgspec.convert(json.loads(file.read_bytes()), Kept)
    made = msgspec.structs.replace(kept, short=digits_of(short), short_made_with=software())
    file.write_bytes(as_file(made))


def as_file(kept: Kept) -> bytes:
    """The contents of the file, with a line for each outcome.

    Values that are not finite are NaN and Infinity, as the module json writes and reads them.
    """
    builtins = msgspec.to_builtins(kept)
    text = json.dumps(builtins, ensure_ascii=False, separators=(",", ":")).encode()
    for start in (b'{"pattern"', b'{"what"', b'"short"', b'"short_made_with"'):
        text = text.replace(start, b"\n" + start)
    return text.strip() + b"\n"


def kept_outcomes() -> dict[str, Kept]:
    """The outcomes that were kept, by pattern."""
    files = sorted(PATTERNS.glob(f"*/{KEPT}"))
    return {
        path.parent.name: msgspec.convert(json.loads(path.read_bytes()), Kept) for path in files
    }


def at_most(
    pattern: str,
    what: str,
    bound: float,
    values: Sequence[float] | Joined,
    source: str,
    of_runs: int = 0,
) -> Outcome:
    """An outcome that is reached if all values are at most `bound`.

    Without a value, or with NaN, it is not reached. `of_runs`: as in `Outcome`.
    """
    wanted = f"<= {bound:g}" if bound else "0"
    return _judged(pattern, what, wanted, values, source, lambda value: value <= bound, of_runs)


def at_least(
    pattern: str,
    what: str,
    bound: float,
    values: Sequence[float] | Joined,
    source: str,
    of_runs: int = 0,
) -> Outcome:
    """An outcome that is reached if all values are at least `bound`.

    Without a value, or with NaN, it is not reached. `of_runs`: as in `Outcome`.
    """
    wanted = f">= {bound:g}"
    return _judged(pattern, what, wanted, values, source, lambda value: value >= bound, of_runs)


def reported(pattern: str, what: str, values: Sequence[float] | Joined, source: str) -> Outcome:
    """A measured number without a condition: each value is accepted."""
    return _judged(pattern, what, UNBOUNDED, values, source, lambda value: True)


def within(pattern: str, what: str, low: float, high: float, value: Joined, source: str) -> Outcome:
    """An outcome that is reached if the value is from `low` to `high`."""
    wanted = f"{low:g} to {high:g}"
    return _judged(pattern, what, wanted, value, source, lambda value: low <= value <= high)


def _judged(
    pattern: str,
    what: str,
    wanted: str,
    values: Sequence[float] | Joined,
    source: str,
    is_good: Callable[[float], bool],
    of_runs: int = 0,
) -> Outcome:
    joined = values if isinstance(values, Joined) else None
    some = (values.value,) if isinstance(values, Joined) else tuple(values)
    is_reached = len(some) > 0 and all(map(is_good, some))
    return Outcome(pattern, what, wanted, some, is_reached, source, joined, of_runs)


def metric(results: Results, name: str) -> list[float]:
    """A metric of each run; NaN, which no bound accepts, where a run has no value."""
    return [float(value) for value in results.metric(name)]


def no_contacts(pattern: str, results: Results) -> Outcome:
    """Whether no robot touches another or the arena."""
    both = metric(results, "robot_contacts"), metric(results, "arena_contacts")
    contacts = [robots + arena for robots, arena in zip(*both, strict=True)]
    return at_most(pattern, "contacts", 0.0, contacts, "docs/safety.md")


def number(value: float | None) -> float:
    """A metric's value; NaN, which no bound accepts, if the run has none."""
    return math.nan if value is None else value
