"""What patterns are, as JSON: printed by a host process, since tools never import plugin code.

A line `{"begin": name, "source": ...}` before each pattern and a row after it, at last
`{"end": true}`: whoever reads knows which one has ended this process, or keeps it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.core.values import Platform
from swarmd.kit.behavior import MovementPattern, Pattern
from swarmd.kit.combined import CombinedPattern
from swarmd.kit.factory import assemble
from swarmd.kit.params import schema
from swarmd.kit.touch import check_zone, describe_zone
from swarmd.kit.voting_pattern import VotingPattern
from swarmd.mission.mission import Mission
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.settings.settings import load_platform


def print_catalog(names: Sequence[str], plugin_dir: str | None, platform: str) -> int:
    """Print the named patterns (none: all), a JSON line each; 0, or 1 if a name is unknown."""
    found = pattern_names(Path(plugin_dir) if plugin_dir else None)
    finder = PatternLoader({name: (origin.value, origin.is_file) for name, origin in found.items()})
    robot = load_platform(platform)
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answer:
        os.dup2(2, 1)  # what a plugin prints is not part of the answer
        for name in names or found:
            source = found[name].source if name in found else ""
            print(json.dumps({"begin": name, "source": source}), file=answer, flush=True)
            row = _describe(name, source, finder, robot)
            print(json.dumps(row), file=answer, flush=True)
        print(json.dumps({"end": True}), file=answer, flush=True)
    return 1 if any(name not in found for name in names) else 0


def _describe(name: str, source: str, finder: PatternLoader, platform: Platform) -> dict[str, Any]:
    try:
        kind = finder(name)
        params = schema(kind.params_type)
        derived = kind.defaults(platform)
        check_zone(name, kind.touches)
        is_tried = issubclass(kind, Mission) and kind.needs <= platform.provides
        is_whole = not any(spec.is_required for spec in params)
        refused = _refusal(name, finder, platform) if is_tried and is_whole else ""
    except (Exception, SystemExit) as error:  # a plugin may raise anything
        text = str(error) if isinstance(error, SwarmError) else f"{type(error).__name__}: {error}"
        return {"name": name, "error": text, "source": source}
    return {
        "name": name,
        "summary": (kind.__doc__ or "").strip().split("\n")[0],
        "text": (kind.__doc__ or "").strip(),
        "kind": _kind(kind),
        "source": source,
        "needs": sorted(kind.needs),
        "missing": sorted(kind.needs - platform.provides),
        "channels": {channel: of.__name__ for channel, of in dict(kind.channels).items()},
        "rate": kind.rate,
        "touches": None if kind.touches is None else describe_zone(kind.touches),
        "platform": platform.name,
        "refused": refused,
        "params": [
            {
                **asdict(spec),
                "wanted": spec.wanted,
                "default": derived.get(spec.name, spec.default),
                "is_derived": spec.name in derived,
            }
            for spec in params
        ],
    }


def _refusal(name: str, finder: PatternLoader, platform: Platform) -> str:
    """Why a robot of that platform would refuse a mission; empty if it would not."""
    try:
        assemble(
            name, (), find=finder, robot="checked", platform=platform, rng=np.random.default_rng(0)
        )
    except SwarmError as error:
        return str(error)
    return ""


def _kind(kind: type[Pattern[Any]]) -> str:
    if issubclass(kind, Mission):
        return "mission"
    if issubclass(kind, CombinedPattern):
        return "combined"
    if issubclass(kind, VotingPattern):
        return "voting"
    return "movement" if issubclass(kind, MovementPattern) else "pattern"
