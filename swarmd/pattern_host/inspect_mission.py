"""Checks a mission file as a whole and prints one JSON line; run with `python -m`.

It imports the patterns that the mission names, so tools run it in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from swarmd.core.errors import PluginError, SwarmError
from swarmd.core.keys import is_id
from swarmd.core.values import Platform, Value
from swarmd.kit.behavior import Pattern
from swarmd.kit.conditions import needs_of
from swarmd.kit.factory import Find, assemble
from swarmd.mission.mission import mission_class, pattern_classes
from swarmd.mission.schema import Document, conditions, fault_lines, read_document
from swarmd.mission.validate import (
    PartBuilder,
    build_parts,
    build_setters,
    check_reports,
    error_text,
)
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import MISSION, Origin, is_mission, pattern_names
from swarmd.settings.layered import fault_at
from swarmd.settings.settings import load_platform


def check_mission(path: Path, platform: Platform, plugin_dir: Path | None) -> list[str]:
    """A line for each fault of the file, for robots of that platform; nothing is run.

    ConfigError if it is not YAML at all.
    """
    document = read_document(path)
    origins = pattern_names(plugin_dir)
    found = origins.get(path.stem)
    if not is_id(path.stem) or path.suffix != MISSION:
        text = "is in a file of a name that no pattern can have; wanted such as patrol.yaml"
        document.faults.append(fault_at(("mission",), text))
    elif document.description and not is_mission(path):
        text = "is not at the start of a line of UTF-8 text, by which robots know a mission's file"
        document.faults.append(fault_at(("mission",), text))
    elif found is not None and not _is_same(path, found):
        other = found.source if _is_file(path, found.rival) else found.rival or found.source
        text = f"has the name of another pattern ({other}); rename one"
        document.faults.append(fault_at(("mission",), text))
    values = {name: (origin.value, origin.is_file) for name, origin in origins.items()}
    find = PatternLoader({**values, path.stem: (str(path.resolve()), True)})
    _check_parts(document, platform, find)
    if not document.faults:
        _check_whole(document, platform, find)
    return fault_lines(path, document.faults)


def _is_same(path: Path, origin: Origin) -> bool:
    """Whether the pattern of that name is this file, and nothing else."""
    files = [origin.value, *([origin.rival] if origin.rival else [])]
    return all(_is_file(path, file) for file in files)


def _is_file(path: Path, name: str) -> bool:
    return Path(name).resolve() == path.resolve()


def _check_parts(document: Document, platform: Platform, find: Find) -> None:
    """Patterns, their parameters, and the values of maps."""
    classes = pattern_classes(document, find)
    document.parts = {name: part for name, part in document.parts.items() if name in classes}

    def make(
        inner: str, /, *, part: str = "", private: bool = False, **params: Value
    ) -> Pattern[Any]:
        layers = (("platform", platform.patterns.get(inner, {})), (document.path.stem, params))
        return assemble(
            inner,
            layers,
            find=find,
            robot="checked",
            platform=platform,
            rng=np.random.default_rng(0),
            channel_prefix=f"{part}-" if private else f"{inner}/",
        ).pattern

    builder = PartBuilder(document, make, {}, document.faults)
    parts = build_parts(builder)
    build_setters(builder, parts)
    check_reports(builder, parts)
    for keys, condition in conditions(document.root):
        for need in sorted(needs_of(condition) - platform.provides):
            text = f"needs {need}, which {platform.name} does not provide"
            document.faults.append(fault_at(keys, text))


def _check_whole(document: Document, platform: Platform, find: Find) -> None:
    """All as a robot would do it; what only that finds is told as of the whole file."""
    try:
        mission_class(document.path, find)
        assemble(
            document.path.stem,
            (),
            find=find,
            robot="checked",
            platform=platform,
            rng=np.random.default_rng(0),
        )
    except SwarmError as error:
        document.faults.append(((), str(error)))


def main() -> int:
    """Print `{"faults": [...]}`, or `{"error": ...}` if there is no looking at it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--platform", default="waffle_pi")
    parser.add_argument("--plugin-dir", type=Path)
    args = parser.parse_args()
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answer:
        os.dup2(2, 1)  # what a plugin prints is not part of the answer
        try:
            platform = load_platform(args.platform)
            faults = check_mission(args.file, platform, args.plugin_dir)
            print(json.dumps({"faults": faults}), file=answer)
        except PluginError as error:
            print(json.dumps({"error": str(error)}), file=answer)
        except SwarmError as error:
            print(json.dumps({"faults": [str(error)]}), file=answer)
        except (Exception, SystemExit) as error:  # a plugin may raise anything
            text = f"{args.file}: a pattern that it names raises {error_text(error)}"
            print(json.dumps({"error": text}), file=answer)
    return 0


if __name__ == "__main__":
    sys.exit(main())
