"""`swarmctl exp check`, `export`, `report`, `plot`, `view`: the results of an experiment."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from swarmd.core.errors import ConfigError, SwarmError, unknown
from swarmd.core.numbers import finite_number
from swarmd.operator.cli.output import print_json, print_table, warn
from swarmd.operator.cli.record_merge import parts_of
from swarmd.operator.cli.web import WebOptions, check_web, serve, web_options
from swarmd.operator.texts.values import NOTHING, counted, megabytes
from swarmd.sim.cli.exp_outcomes import check_outcomes
from swarmd.sim.cli.options import (
    chosen_metrics,
    folder_argument,
    need,
    out_option,
    output_option,
    trust_option,
    warn_of_few,
)

if TYPE_CHECKING:
    from swarmd.sim.experiments.export import Form
    from swarmd.sim.experiments.requirements import RequirementFinding
    from swarmd.sim.experiments.results import Results
    from swarmd.sim.metrics.metric import Metric

_MODULES = {
    "csv": ("sim,table", "pandas", "scipy"),
    "parquet": ("sim,table", "pandas", "pyarrow", "scipy"),
}
MISSED = 1  # exit code


@click.command("export", epilog="Example: swarmctl exp export runs/gather --to parquet -o gather")
@folder_argument
@click.option(
    "--to",
    "form",
    type=click.Choice(list(_MODULES)),
    required=True,
    help="The format of the tables of results and traces.",
)
@out_option("Folder of the files [DIR/export].", "-o")
@click.option("--no-traces", is_flag=True, help="Only the results of each run.")
def export(folder: Path, form: str, out: Path | None, no_traces: bool) -> None:
    """Write the experiment in DIR as tables for pandas and R.

    The file `results` has a row for each run; the files in `traces` have a row for each instant
    and robot.
    """
    extra, *modules = _MODULES[form]  # the extra of swarmd that installs these modules
    need(*modules, extra=extra)
    from swarmd.sim.cli.progress import progress
    from swarmd.sim.experiments.export import export as exported
    from swarmd.sim.experiments.results import load_results
    from swarmd.sim.experiments.simulate import Progress

    results = load_results(folder)
    written: list[Path] = []
    target_folder = out or folder / "export"
    total = 0 if no_traces else len(results.runs)  # traces, of which all count as equal work
    try:
        with progress() as show:
            for path in exported(results, cast("Form", form), target_folder, traces=not no_traces):
                written.append(path)
                done = sum(file.stem != "results" for file in written)
                show(Progress(done, total, 0, worked=float(done), left=float(total - done)))
    finally:  # after an error the user also gets the names of the files that are written
        # Only now: the progress bar would overwrite the names.
        click.echo("\n".join(map(str, written)))


@click.command(epilog="Example: swarmctl exp check runs/first 'median(gather_time) <= 40'")
@click.argument("experiment", metavar="DIR")
@click.argument("requirements", metavar="[REQUIREMENT..]", nargs=-1)
@click.option(
    "--sure",
    "must_be_sure",
    is_flag=True,
    help="Exit code 0 only if each requirement is met, and by at least 10 runs.",
)
@output_option
@click.pass_context
def check(
    ctx: click.Context,
    experiment: str,
    requirements: tuple[str, ...],
    must_be_sure: bool,
    is_json: bool,
) -> None:
    """Check whether the experiment in DIR, or DIR:VARIANT of a sweep, meets requirements.

    A requirement is 'METRIC >= VALUE' in quotes. It concerns the mean of the metric over all runs.
    'median(METRIC)', 'min(METRIC)' and 'max(METRIC)' stand for other statistics, and 'runs' for the
    number of runs, 'share(METRIC)' for the share of runs for which a metric is 1. Comparisons are
    >= <= > < ==. Every variant of a sweep must meet each requirement.

    If DIR holds the runs of a file of outcomes (`exp run PATTERN/outcomes.yaml`), its rows are the
    requirements, and none is given here.

    The 95 % interval of a mean or median decides: 'met' if all of it meets the requirement, 'not
    met' if nothing of it does, else 'undecided'. More runs decide; `exp run --until` makes as many
    as it takes. min, max and runs are numbers of these runs alone.

    Exit code 1 if a requirement is not met or a planned run is missing; with --sure also if a
    requirement is undecided, or met by the bootstrap interval of fewer than 10 runs. Else 0.
    """
    from swarmd.sim.experiments import requirements as checking
    from swarmd.sim.experiments.compare import sides_of
    from swarmd.sim.experiments.manifest import NAME as MANIFEST
    from swarmd.sim.experiments.outcomes import NAME

    place = Path(experiment)
    if (place / NAME).is_file() and not (place / MANIFEST).exists():
        if requirements:
            raise ConfigError(
                f"{place}: {NAME} in it has the requirements; leave out {requirements[0]!r}, or"
                " name the folder of runs in it"
            )
        is_reached = check_outcomes(place, must_be_sure=must_be_sure, is_json=is_json)
        ctx.exit(0 if is_reached else MISSED)
    if place.is_file():
        raise ConfigError(
            f"{place} is a file; expected the folder that `swarmctl exp run` has made"
        )
    if not requirements:
        raise ConfigError(
            f"{experiment}: there is no requirement, and no {NAME} in the folder; expected one such"
            " as 'median(gather_time) <= 60'"
        )
    parsed = [checking.parse_requirement(text) for text in requirements]
    sides = sides_of(experiment)  # one for each variant
    findings = [checking.check(requirement, side) for side in sides for requirement in parsed]
    missing_runs = sides[0].results.lacking  # a text; empty if no run is missing
    is_passed = not missing_runs and all(
        finding.is_sure if must_be_sure else finding.verdict is not checking.Verdict.NOT_MET
        for finding in findings
    )
    if is_json:
        listed = [finding.document() for finding in findings]
        print_json("Check", {"passed": is_passed, "missing": missing_runs, "requirements": listed})
    else:
        _print_findings(findings)
    if missing_runs:
        warn(f"not complete: {missing_runs}")
    warn_of_few(finding.few for finding in findings)
    counts = Counter(finding.verdict for finding in findings)
    open_ones = f", {counts[checking.Verdict.UNDECIDED]} undecided"
    so_far = " so far" if missing_runs else ""
    warn(
        f"{counts[checking.Verdict.MET]} of {counted(len(findings), 'requirement')} met"
        f"{open_ones if counts[checking.Verdict.UNDECIDED] else ''}{so_far}"
    )
    ctx.exit(0 if is_passed else MISSED)


def _print_findings(findings: Sequence[RequirementFinding]) -> None:
    """Print a row for each requirement and variant."""
    from swarmd.sim.experiments.statistics import interval, number

    rows = []
    for finding in findings:
        remark = f" ({finding.remark})" if finding.remark else ""
        rows.append(
            (
                finding.requirement.text,
                finding.variant or NOTHING,
                number(finding.value),
                interval(finding.interval),
                f"{finding.verdict}{remark}",
            )
        )
    print_table(("REQUIREMENT", "VARIANT", "VALUE", "95 %", "RESULT"), rows)


@click.command(epilog="Example: swarmctl exp report runs/gather")
@click.argument("place", metavar="DIR|FILE.mcap", type=click.Path(path_type=Path))
@out_option("The report [DIR/report.html, or FILE.html].", "-o", is_file=True)
@click.option("--metrics", metavar="A,B,..", help="Show these metrics first, and draw them.")
@click.option("--seed", type=click.IntRange(min=0), help="The run to play [a typical one].")
@click.option("--variant", metavar="NAME", help="Of a sweep, the variant of the run to play.")
@trust_option
def report(
    place: Path,
    out: Path | None,
    metrics: str | None,
    seed: int | None,
    variant: str | None,
    is_trusted: bool,
) -> None:
    """Write the experiment in DIR as one HTML file: results, figures, a run to play, the manifest.

    With FILE.mcap, the recording of one robot or of a swarm (`record merge`), or with a folder of
    recordings (`record fetch`, `incidents fetch`), the report has states, gaps, stops, and paths by
    odometry. Its player begins 10 s before an incident. A report needs no network and no other
    file, and prints well.

    Exit code 1 if planned runs of the experiment are missing.
    """
    # 1. The path of the report.
    need("mujoco", "matplotlib")
    from swarmd.sim.experiments.manifest import write_whole

    is_recording = place.suffix == ".mcap" or _has_recordings(place)
    path = out or (place.with_suffix(".html") if place.is_file() else place / "report.html")
    if out is not None and (path.suffix != ".html" or not path.parent.is_dir()):
        raise ConfigError(f"{path}: expected a name that ends in .html, in a folder that exists")

    # 2. The text of the report.
    results: Results | None = None  # of an experiment; a recording has none
    if is_recording:
        if any(option is not None for option in (metrics, seed, variant)):
            raise ConfigError(f"{place}: --metrics, --seed and --variant are for experiments")
        need("mcap", "rosbags", extra="sim,plot,record")
        from swarmd.sim.report.recording_report import recording_report

        text = recording_report(parts_of((place,)), place)
    else:
        from swarmd.sim.experiments.results import load_results
        from swarmd.sim.report.html import report_of

        results = load_results(place, is_trusted=is_trusted)
        chosen = metrics_of(results, metrics)
        warn(f"measuring, drawing and writing {len(results.runs)} runs ...")
        # `report_of` loads the folder again, without trust. That is no obstacle: the metrics of
        # `chosen` hold the code that `is_trusted` has allowed.
        text = report_of(place, chosen, seed, variant)

    # 3. The file.
    try:
        write_whole(path, text)
    except OSError as error:
        raise SwarmError(f"{path}: cannot be written: {error.strerror or error}") from error
    click.echo(f"{path}: {megabytes(path.stat().st_size, 2)}")
    if results is not None:
        exit_if_incomplete(results)


def _has_recordings(folder: Path) -> bool:
    """True for a folder with recordings that is no experiment."""
    from swarmd.sim.experiments.manifest import NAME

    return not (folder / NAME).exists() and folder.is_dir() and any(folder.rglob("*.mcap"))


@click.command(epilog="Example: swarmctl exp view runs/gather --seed 7")
@folder_argument
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
    from swarmd.sim.view.trace_source import source_of

    serve(source_of(folder, seed, variant), None, page)


_INCHES = {"in": 1.0, "cm": 1.0 / 2.54, "mm": 0.1 / 2.54, "pt": 1.0 / 72.27}
_NARROWEST = 2.0
_WIDEST = 20.0


@click.command("plot", epilog="Example: swarmctl exp plot runs/rules --metrics consensus_time")
@folder_argument
@out_option("Folder of the pictures [DIR/plots; with --seeds DIR/plots/seeds-SEEDS].", "-o")
@click.option(
    "--metrics",
    metavar="A,B,..",
    help="Draw these metrics; also report:KEY, reading:KEY and FILE.py:NAME.",
)
@click.option(
    "--seeds", metavar="SEEDS", help="Draw only the runs of these seeds: 7, 500-519, or 3,5,9."
)
@click.option("--facet", metavar="KEY", help="A panel for each value of this swept key.")
@click.option(
    "--target",
    "targets",
    multiple=True,
    metavar="METRIC=VALUE",
    help="Draw a line at this value of a metric; may be repeated.",
)
@click.option(
    "--only",
    metavar="A,B,..",
    help="Draw these pictures: intervals, differences, survival, over_time, curve (over a swept"
    " number), runs (all from above), trajectories (of a typical and the worst run) [the first"
    " four; with --seeds all but the curve].",
)
@click.option(
    "--label",
    "labels",
    multiple=True,
    metavar="NAME=TEXT",
    help="Name a swept key or a metric on axes, such as range='lidar range [m]'; may be repeated.",
)
@click.option(
    "--format",
    "form",
    type=click.Choice(["png", "svg", "pdf"]),
    default="png",
    show_default=True,
    help="Form of the files.",
)
@click.option(
    "--width",
    metavar="LENGTH",
    help="For a paper: pictures of this width, such as 3.5in, 89mm or 252pt, with texts of 6 to 8"
    " points and without titles; panels have letters.",
)
@trust_option
def plot(
    folder: Path,
    out: Path | None,
    metrics: str | None,
    seeds: str | None,
    facet: str | None,
    targets: tuple[str, ...],
    only: str | None,
    labels: tuple[str, ...],
    form: str,
    width: str | None,
    is_trusted: bool,
) -> None:
    """Draw the experiment in DIR: metrics by run and over time, differences, trajectories.

    Without --metrics, the metrics that were given to `exp run` are drawn, if any. Exit code 1 if
    planned runs are missing.
    """
    need("matplotlib")
    from swarmd.sim.experiments.plan import parse_seeds
    from swarmd.sim.experiments.results import load_results
    from swarmd.sim.plots.figures import Look, draw_experiment

    if seeds and out is None:  # a folder of their own: the pictures of all runs stay as they are
        out = folder / "plots" / f"seeds-{seeds}"
    # A single number is a seed here, not a number of seeds.
    seeds_text = f"{seeds}-{seeds}" if seeds and seeds.isdecimal() else seeds
    inches = None if width is None else parse_width(width)
    results = load_results(folder, is_trusted=is_trusted)
    target_by_name = parse_targets(targets)
    look = Look(
        suffix=f".{form}",
        width=inches,
        facet=facet,
        # By the names of the metrics: path/to/file.py:warm has the name file.py:warm.
        targets={results.asked(text).name: value for text, value in target_by_name.items()},
        only=None if only is None else parse_kinds(only),
        labels=parse_labels(labels),
    )
    chosen = metrics_of(results, metrics)
    # `draw_experiment` loads the folder again, without trust. That is no obstacle: the metrics of
    # `chosen` hold the code that `is_trusted` has allowed.
    paths = draw_experiment(
        folder,
        out,
        metrics=chosen,
        seeds=parse_seeds(seeds_text) if seeds_text else None,
        look=look,
    )
    for path in paths:
        click.echo(str(path))
    if not paths:
        warn("nothing differs between runs; for paths from above: --only runs,trajectories")
    exit_if_incomplete(results)


def metrics_of(results: Results, text: str | None) -> Sequence[Metric] | None:
    """The metrics of `--metrics`, else the metrics given to `exp run`; None without both.

    `text`: the value of `--metrics`, or None.
    """
    from swarmd.sim.experiments.manifest import read_manifest

    if text is None and (shown := read_manifest(results.folder).shown):
        return [*map(results.asked, shown)]
    return chosen_metrics(text, results.asked)


def exit_if_incomplete(*experiments: Results) -> None:
    """End the verb with the exit code of `exp check` if planned runs are missing."""
    lacking = {results.folder: results.lacking for results in experiments if results.lacking}
    for folder, text in lacking.items():
        warn(f"{folder}: not complete: {text}")
    if lacking:
        click.get_current_context().exit(MISSED)


def parse_width(text: str) -> float:
    """Inches of a width such as `3.5in`, `89mm` or `252pt`; ConfigError for another text."""
    match = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]+)?)\s*(in|cm|mm|pt)\s*", text)
    inches = float(match[1]) * _INCHES[match[2]] if match else 0.0
    if not _NARROWEST <= inches <= _WIDEST:
        raise ConfigError(f"--width {text!r}: expected 2in to 20in, such as 3.5in, 89mm or 252pt")
    return inches


def parse_kinds(text: str) -> tuple[str, ...]:
    """The kinds of pictures of `--only A,B`; ConfigError for an unknown one."""
    from swarmd.sim.plots.figures import CURVE, KINDS

    kinds = tuple(text.split(","))
    for kind in kinds:
        if kind not in (*KINDS, CURVE):
            raise ConfigError(f"--only: {unknown('picture', kind, (*KINDS, CURVE))}")
    return kinds


def parse_labels(words: Sequence[str]) -> Mapping[str, str]:
    """The texts of `--label NAME=TEXT`; ConfigError for another text."""
    labels = {}
    for word in words:
        name, _, text = word.partition("=")
        if not name or not text.strip():
            raise ConfigError(f"--label {word!r}: expected such as range='lidar range [m]'")
        labels[name] = text.strip()
    return labels


def parse_targets(words: Sequence[str]) -> Mapping[str, float]:
    """The values of `--target METRIC=VALUE`; ConfigError for another text."""
    targets = {}
    for word in words:
        name, _, value = word.rpartition("=")
        targets[name] = finite_number(value)
        if not name or math.isnan(targets[name]):
            raise ConfigError(f"--target {word!r}: expected such as gather_time=60")
    return targets
