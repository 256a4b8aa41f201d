"""The weight of the project in a table, and its limits: `python -m benchmarks.house`.

`--write` lowers the limits of `tests/weights.toml` to the present numbers. `--list NAME` prints the
places of a row of its tables `named` and `counts`.
"""

from __future__ import annotations

import argparse
import re
import statistics
from collections.abc import Iterable

from swarmd.core.key_table import PUBLISHED
from swarmd.core.verbs import VERBS
from swarmd.drivers.ros.options import TopicOptions
from swarmd.plugins import pattern_folders
from swarmd.settings.driver_options import BaseOptions
from swarmd.sim.metrics.catalog import METRICS
from tests.support.weight import (
    ROOT,
    WEIGHTS,
    Weights,
    as_toml,
    lowered,
    measured,
    places,
    read_limits,
    texts,
)
from tests.support.wings import WINGS, wing_of

TABLES = ("source", "tests", "markdown")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.house", description=__doc__)
    parser.add_argument("--write", action="store_true", help="lower the limits")
    parser.add_argument("--list", metavar="NAME", help="the places of a row")
    options = parser.parse_args()
    limits = read_limits()
    if options.list:
        rows = {
            name: row for table in places(limits["named"]).values() for name, row in table.items()
        }
        if options.list not in rows:
            parser.error(f"--list {options.list}: no such row; expected one of {', '.join(rows)}")
        print(*rows[options.list], sep="\n")
        return
    weights = measured(limits)
    if options.write:
        (ROOT / WEIGHTS).write_text(as_toml(lowered(weights, limits)))
    print_weights(weights)
    print_touched()


def print_weights(weights: Weights) -> None:
    """Lines and files by table and wing, then each row of the tables of concepts and forms."""
    for table in TABLES:
        print_row(table, *map(sum, zip(*weights[table].values(), strict=True)))
    wings = dict.fromkeys(WINGS, 0)
    for folder, (lines, _) in weights["source"].items():
        if (wing := wing_of(folder)) is not None:
            wings[wing] += lines
    for wing, lines in wings.items():
        print_row(f"source of {wing}", lines)
    for table in ("named", "counts"):
        for name, (number,) in weights[table].items():
            print_row(f"{table}: {name}", number)


def print_touched() -> None:
    """Print by kind of feature the median number of source files, tests and pages that name one."""
    words = [(table, set(re.findall(r"\w+", text))) for table, _, text in texts()]
    print(f"\n{'files that name':<42}" + "".join(f"{table:>10}" for table in TABLES))
    for feature, names in examples().items():
        counts = [
            [sum(kind == table and name in known for kind, known in words) for table in TABLES]
            for name in names
        ]
        print_row(
            feature, *(round(statistics.median(column)) for column in zip(*counts, strict=True))
        )


def examples() -> dict[str, list[str]]:
    """Names of each kind of feature; those without an underscore are ordinary words as well."""
    options = [*BaseOptions.__struct_fields__, *TopicOptions.__struct_fields__]
    kinds: dict[str, Iterable[str]] = {
        "pattern": pattern_folders(),
        "driver option": options,
        "metric": METRICS,
    }
    return {
        "a sensor (detections)": ["detections"],
        "a sensor (hazards)": ["hazards"],
        "a published value": [row.content.__name__ for row in PUBLISHED.values()],
        "a verb": [row.asked.__name__ for row in VERBS.values() if row.is_request],
        **{f"a {kind}": [name for name in names if "_" in name] for kind, names in kinds.items()},
    }


def print_row(name: str, *numbers: int) -> None:
    print(f"{name:<42}" + "".join(f"{number:>10,}" for number in numbers))


if __name__ == "__main__":
    main()
