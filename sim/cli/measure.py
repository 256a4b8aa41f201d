"""`swarmctl exp measure`: the metrics of recorded traces."""

from __future__ import annotations

from pathlib import Path

import click

from swarmd.cli.output import print_json, print_table
from swarmd.sim.cli.options import chosen_metrics, output_option


@click.command()
@click.argument(
    "files", metavar="TRACE.npz..", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option("--metrics", metavar="A,B,..", help="Only these metrics; see `swarmctl exp metrics`.")
@output_option
def measure(files: tuple[Path, ...], metrics: str | None, is_json: bool) -> None:
    """Compute metrics of traces: of experiments, of `swarmctl demo`, of a recorded world.

    A live trace has no requested commands: metrics that need them stay empty.
    """
    from swarmd.sim.experiments.report import number
    from swarmd.sim.metrics import catalog
    from swarmd.sim.trace import load_trace

    names = chosen_metrics(metrics) or tuple(catalog.METRICS)
    measured = {str(file): catalog.measure(load_trace(file), names) for file in files}
    if is_json:
        print_json("Measurements", {"traces": measured})
        return
    rows = [
        (
            name,
            catalog.METRICS[name].unit or "-",
            *(number(found[name]) for found in measured.values()),
        )
        for name in names
    ]
    stems = [Path(file).stem.upper() for file in measured]
    heads = stems if len(set(stems)) == len(stems) else list(measured)
    print_table(("METRIC", "UNIT", *heads), rows)
