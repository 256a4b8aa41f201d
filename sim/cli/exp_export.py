"""`swarmctl exp export`: an experiment for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from swarmd.sim.cli.options import need

if TYPE_CHECKING:
    from swarmd.sim.experiments.export import Form

_MODULES = {
    "csv": ("sim,table", "pandas", "scipy"),
    "parquet": ("sim,table", "pandas", "pyarrow", "scipy"),
    "mcap": ("sim,record", "mcap", "rosbags", "scipy"),
}


@click.command("export")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--to",
    "form",
    type=click.Choice(list(_MODULES)),
    required=True,
    help="Tables of results and traces as csv or parquet; or a file of each run as mcap.",
)
@click.option(
    "-o",
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Folder of the files [DIR/export].",
)
@click.option("--no-traces", is_flag=True, help="Only the results of each run.")
def export(folder: Path, form: str, out: Path | None, no_traces: bool) -> None:
    """Write the experiment in DIR as tables for pandas and R, or as MCAP for Foxglove.

    The file `results` has a row for each run; the files in `traces` have a row for each instant
    and robot.
    """
    if no_traces and form == "mcap":
        raise click.UsageError("--to mcap exports traces; leave out --no-traces")
    extra, *modules = _MODULES[form]
    need(*modules, extra=extra)
    from swarmd.sim.experiments.export import export as exported
    from swarmd.sim.experiments.results import load_results

    results = load_results(folder)
    for path in exported(
        results, cast("Form", form), out or folder / "export", traces=not no_traces
    ):
        click.echo(str(path))
