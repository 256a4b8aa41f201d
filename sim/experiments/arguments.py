"""Parse the arguments of experiments: `--seeds`, `--set` and `--sweep`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from swarmd.core.errors import ConfigError
from swarmd.sim.experiments.plan import MAX_RUNS, check_seeds
from swarmd.sim.scenarios.overrides import SWEEP_SOURCE, parse_override


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
                " wanted 20 (0 to 19), 500-519 or 3,5,9"
            )
        _bounded(len(seeds) + last - first + 1, text)
        seeds += range(first, last + 1)
    return check_seeds(seeds)


def parse_sets(words: Iterable[str]) -> dict[str, Any]:
    """The values of `--set key=value`; ConfigError for an invalid or repeated one."""
    found: dict[str, Any] = {}
    for word in words:
        key, value = parse_override(word)
        if key in found:
            raise ConfigError(f"--set {key} is given twice; keep one")
        found[key] = value
    return found


def parse_sweeps(words: Iterable[str]) -> dict[str, list[Any]]:
    """The values of `--sweep key=a,b,c` by key; ConfigError for an invalid or repeated one."""
    found: dict[str, list[Any]] = {}
    for word in words:
        key, equals, text = word.partition("=")
        if not equals or not all(key.strip().split(".")):
            raise ConfigError(f"--sweep {word!r}: wanted is key=a,b,c, such as duration=30,60")
        if key.strip() in found:
            raise ConfigError(f"--sweep {key.strip()} is given twice; put all values in one")
        values = split_values(key.strip(), text)
        found[key.strip()] = [parse_override(f"{key}={value}", SWEEP_SOURCE)[1] for value in values]
    return found


def split_values(key: str, text: str) -> tuple[str, ...]:
    """The values of a sweep from `a,b,c`; commas within brackets and quotes do not separate."""
    parts, depth, quote = [""], 0, ""
    for char in text:
        if char == quote:
            quote = ""
        elif not quote and char in "'\"":
            quote = char
        elif not quote and char in "[]{}":
            depth += 1 if char in "[{" else -1
        if char == "," and not depth and not quote:
            parts.append("")
        else:
            parts[-1] += char
    values = tuple(part.strip() for part in parts)
    if not all(values):
        raise ConfigError(f"--sweep {key}={text}: a value is empty; wanted such as {key}=0.1,0.2")
    return values


def _bounded(count: int, text: str) -> int:
    if count > MAX_RUNS:
        raise ConfigError(f"--seeds {text}: {count} seeds; at most {MAX_RUNS} are taken")
    return count
