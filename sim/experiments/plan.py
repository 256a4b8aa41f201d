"""The plan of an experiment: variants of a scenario, seeds and runs, and its arguments as texts."""

from __future__ import annotations

import hashlib
import heapq
import itertools
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral
from typing import Any

import msgspec

from swarmd.core.errors import ConfigError
from swarmd.sim.scenarios.overrides import SOURCE, SWEEP_SOURCE, parse_override

MAX_RUNS = 100_000
MAX_SEED = 2**32 - 1
_LONGEST = 120  # characters of a run's id, which is a file's name


class Variant(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One point of a parameter sweep."""

    name: str  # such as `speed=0.1,law=paper`; empty without a sweep
    values: Mapping[str, Any]  # by swept key
    effective: Mapping[str, Any]  # the complete scenario

    def __repr__(self) -> str:
        return f"Variant({self.name!r}, {dict(self.values)})"


class Shard(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Part number `part`, counted from 1, of `of` parts; ValueError if it is out of range."""

    part: int
    of: int

    def __post_init__(self) -> None:
        if not 1 <= self.part <= self.of <= MAX_RUNS:
            raise ValueError(f"there is no part {self}")

    def __str__(self) -> str:
        return f"{self.part}/{self.of}"


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a variant with a seed. `id` is unique in the plan, and a safe file name."""

    id: str
    variant: Variant
    seed: int

    @property
    def title(self) -> str:
        """`speed=0.1, seed 3`, or the seed alone where nothing is swept."""
        name = self.variant.name
        return f"{name}, seed {self.seed}" if name else f"seed {self.seed}"

    @property
    def robots(self) -> int:
        """The number of robots, at least 1."""
        groups = self.variant.effective.get("groups", {}).values()
        return max(sum(len(g.get("robots") or ()) or g.get("count") or 1 for g in groups), 1)

    @property
    def robot_seconds(self) -> float:
        """Robots times simulated seconds: the measure of the work of a run."""
        return float(self.variant.effective.get("duration", 1.0)) * self.robots


@dataclass(frozen=True, slots=True)
class Plan:
    """All runs of an experiment: each variant with each seed."""

    scenario: str
    seeds: tuple[int, ...]
    variants: tuple[Variant, ...]
    sets: Mapping[str, Any] = field(default_factory=dict)
    """Overrides of the scenario in all variants, by dotted key."""
    sweep: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    """The values of the swept overrides, by dotted key."""
    shard: Shard | None = None
    """The part of the experiment that `runs` has; None: all runs."""

    @property
    def runs(self) -> tuple[Run, ...]:
        """The runs in order: by variant, then by seed."""
        stems = _stems([variant.name for variant in self.variants])
        every = tuple(
            Run(f"{stem}_s{seed:04d}" if stem else f"s{seed:04d}", variant, seed)
            for stem, variant in zip(stems, self.variants, strict=True)
            for seed in self.seeds
        )
        if self.shard is None:
            return every
        parts = parts_of(every, self.shard.of)
        return tuple(run for run in every if parts[run.id] == self.shard.part)


def check_seeds(seeds: Iterable[int]) -> tuple[int, ...]:
    """The seeds; ConfigError if they are empty, repeated or invalid."""
    if not isinstance(seeds, Iterable):
        raise ConfigError(f"seeds is {seeds!r}; expected a whole number, or several")
    listed = tuple(seeds)
    if not listed:
        raise ConfigError("seeds: empty; expected at least one, such as --seeds 20")
    seen: set[int] = set()
    for seed in listed:
        if isinstance(seed, bool) or not isinstance(seed, Integral) or not 0 <= seed <= MAX_SEED:
            raise ConfigError(f"seeds: {seed!r} is no seed; expected whole numbers 0 to {MAX_SEED}")
        if seed in seen:
            raise ConfigError(f"seeds: {seed} is given twice; keep one")
        seen.add(seed)
    return tuple(map(int, listed))  # JSON cannot hold numpy's


def make_plan(
    scenario: str,
    seeds: Iterable[int],
    sets: Mapping[str, Any],
    sweep: Mapping[str, Sequence[Any]],
    effective: Callable[[Mapping[str, Any]], Mapping[str, Any]],
) -> Plan:
    """The plan of an experiment: each seed with each combination of the values of `sweep`.

    A combination is a variant. The last key of `sweep` changes fastest. `sets`: overrides of all
    variants by dotted key. `effective` gives the complete scenario for overrides, and raises
    ConfigError for invalid overrides. It is called for every variant here, so that errors appear
    before the first run.
    """
    planned_seeds = check_seeds(seeds)
    for key, values in sweep.items():
        _check_sweep(key, values, sets, sweep)
    count = len(planned_seeds) * math.prod(map(len, sweep.values()))
    if count > MAX_RUNS:
        raise ConfigError(f"these are {count} runs; at most {MAX_RUNS} are made, so sweep less")
    # A variant's name has the last word of each key, or the whole key if two last words are equal.
    last_words = [key.rpartition(".")[2] for key in sweep]
    short_key = {
        key: word if last_words.count(word) == 1 else key
        for key, word in zip(sweep, last_words, strict=True)
    }
    variants = []
    for combination in itertools.product(*sweep.values()):
        value_of = dict(zip(sweep, combination, strict=True))
        name = ",".join(f"{short_key[key]}={shown(value)}" for key, value in value_of.items())
        variants.append(Variant(name, value_of, effective({**sets, **value_of})))
    swept = {key: list(values) for key, values in sweep.items()}
    return Plan(scenario, planned_seeds, tuple(variants), dict(sets), swept)


def shown(value: object) -> str:
    """A swept value as text in names and columns."""
    is_plain = isinstance(value, str) and value.isprintable()
    return str(value) if is_plain else json.dumps(value, separators=(",", ":"))


def parts_of(runs: Sequence[Run], count: int) -> dict[str, int]:
    """Divide runs into `count` parts of about equal work; returns the part (1..count) by run id.

    The runs are taken in the order of decreasing work. Each run goes to the part with the least
    work so far (longest processing time rule, Graham 1969).
    """
    loads = [(0.0, part) for part in range(1, count + 1)]  # a heap of (robot-seconds, part)
    part_of = {}
    for run in sorted(runs, key=lambda run: -run.robot_seconds):
        load, part = loads[0]
        heapq.heapreplace(loads, (load + run.robot_seconds, part))
        part_of[run.id] = part
    return part_of


def _check_sweep(
    key: str, values: Sequence[Any], sets: Mapping[str, Any], sweep: Mapping[str, Any]
) -> None:
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise ConfigError(
            f"sweep {key}: {values!r} is no list; expected a value such as [0.1, 0.2]"
        )
    if not values:
        raise ConfigError(f"sweep {key}: there is no value; expected a value such as {key}=0.1,0.2")
    if key in sets:
        raise ConfigError(f"{key} is both set and swept; keep one of them")
    for override in (*sets, *sweep):
        if override.startswith(f"{key}."):
            raise ConfigError(
                f"sweep {key}: {override} is part of it and would be lost; keep one of them"
            )
    name, count = Counter(map(shown, values)).most_common(1)[0]
    if count > 1:
        raise ConfigError(f"sweep {key}: {name} is given twice; keep one")


def _stems(names: Sequence[str]) -> list[str]:
    """Variant names as unique, safe parts of file names, of at most _LONGEST characters each.

    A name that is too long, or equal to a second name but for case, ends with a digest.
    """
    stems = [re.sub(r"[^A-Za-z0-9_.,=+-]", "-", name).lstrip(".-") for name in names]
    folded = [stem.lower() for stem in stems]
    return [
        stem
        if len(stem) <= _LONGEST and folded.count(stem.lower()) == 1
        else f"{stem[: _LONGEST - 9]}~{hashlib.sha256(name.encode()).hexdigest()[:8]}"
        for stem, name in zip(stems, names, strict=True)
    ]


def parse_seeds(text: str) -> tuple[int, ...]:
    """Seeds from `20` (the first twenty: 0 to 19), `500-519`, `3,5,9`, `0-4,10`."""
    if re.fullmatch(r"\d{1,10}", text.strip()):
        return check_seeds(range(_bounded(int(text), text)))
    seeds: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,10})(?:-(\d{1,10}))?\s*", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if last < first:
            raise ConfigError(
                f"--seeds {text!r}: {part!r} is not a seed or range;"
                " expected 20 (0 to 19), 500-519 or 3,5,9"
            )
        _bounded(len(seeds) + last - first + 1, text)
        seeds += range(first, last + 1)
    return check_seeds(seeds)


def parse_shard(text: str) -> Shard:
    """The part that `3/40` names: the third of forty."""
    match = re.fullmatch(r"\s*(\d{1,6})/(\d{1,6})\s*", text)
    try:
        return Shard(*map(int, match.groups() if match else (0, 0)))
    except ValueError:
        raise ConfigError(
            f"--shard {text!r} is no part; expected 3/40 for the third of forty, up to 40/40"
        ) from None


def parse_sets(words: Iterable[str]) -> dict[str, Any]:
    """The values of `--set key=value`; ConfigError for an invalid or repeated one."""
    return _by_key(words, SOURCE, "{}")


def parse_sweeps(words: Iterable[str]) -> dict[str, list[Any]]:
    """The values of `--sweep key=a,b,c` by key; ConfigError for an invalid or repeated one."""
    words = list(words)
    sweeps = _by_key(words, SWEEP_SOURCE, "[{}]")
    for (key, values), word in zip(sweeps.items(), words, strict=True):
        if not values or word.rstrip().endswith(","):  # which YAML allows
            raise ConfigError(
                f"{SWEEP_SOURCE} {key}: a value is empty; expected a value such as 0.1,0.2"
            )
    return sweeps


def _by_key(words: Iterable[str], source: str, form: str) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for word in words:
        key, value = parse_override(word, source, form)
        if key in values:
            raise ConfigError(f"{source} {key} is given twice; keep one")
        values[key] = value
    return values


def _bounded(count: int, text: str) -> int:
    if count > MAX_RUNS:
        raise ConfigError(f"--seeds {text}: {count} seeds; at most {MAX_RUNS} are taken")
    return count
