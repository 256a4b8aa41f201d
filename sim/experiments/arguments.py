"""Parse the arguments of experiments: `--seeds`, `--set` and `--sweep`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from swarmd.core.errors import ConfigError
from swarmd.sim.experiments.plan import MAX_RUNS, Shard, check_seeds
from swarmd.sim.scenarios.overrides import SOURCE, SWEEP_SOURCE, parse_override


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
    found = _by_key(words, SWEEP_SOURCE, "[{}]")
    for (key, values), word in zip(found.items(), words, strict=True):
        if not values or word.rstrip().endswith(","):  # which YAML allows
            raise ConfigError(
                f"{SWEEP_SOURCE} {key}: a value is empty; expected a value such as 0.1,0.2"
            )
    return found


def _by_key(words: Iterable[str], source: str, form: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for word in words:
        key, value = parse_override(word, source, form)
        if key in found:
            raise ConfigError(f"{source} {key} is given twice; keep one")
        found[key] = value
    return found


def _bounded(count: int, text: str) -> int:
    if count > MAX_RUNS:
        raise ConfigError(f"--seeds {text}: {count} seeds; at most {MAX_RUNS} are taken")
    return count
