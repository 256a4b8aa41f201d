"""`swarmctl exp view`: recorded runs on a web page."""

from __future__ import annotations

from pathlib import Path

import click

from swarmd.cli.web import WebOptions, check_web, serve, web_options
from swarmd.sim.cli.options import need


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--seed", type=int, metavar="N", help="The run that is shown first [the first].")
@click.option("--variant", metavar="NAME", help="Of a sweep, the variant that is shown first.")
@web_options
def view(folder: Path, seed: int | None, variant: str | None, page: WebOptions) -> None:
    """Play the recorded runs of the experiment in DIR on a web page.

    The page selects among all seeds and variants. DIR may also be the folder of a demo, or a trace
    (.npz).
    """
    need("mujoco", "websockets", extra="sim,web")
    check_web(page)
    from swarmd.sim.view.experiment import source_of

    serve(source_of(folder, seed, variant), None, page)
