"""A report of an experiment: one HTML file that needs no network and no other file."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.core.values import Array
from swarmd.operator.view.source import Source
from swarmd.settings.yamlfile import text_of
from swarmd.sim.experiments.manifest import Manifest, read_manifest
from swarmd.sim.experiments.results import YES_OR_NO, Results, load_results
from swarmd.sim.experiments.statistics import FEW, METHOD, number
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.metrics.metric import Metric
from swarmd.sim.plots.select import label_of, primary_metric, typical_first
from swarmd.sim.report.figures import figures_html, figures_of
from swarmd.sim.report.player import Player, player_of, script
from swarmd.sim.report.tables import (
    contacts_table,
    differences_tables,
    events_table,
    manifest_table,
    metrics_table,
    shown_metrics,
)
from swarmd.sim.view.trace_source import source_of

_PLAYER = """
<p>{what}. Sampled every {period:.2g} s.</p>
<div id="player">
<div class="bar">
<label>Colour <select id="colour"></select></label>
<label><input type="checkbox" id="trails" checked> Trails</label>
<label><input type="checkbox" id="names" checked> Names</label>
<button id="fit" type="button">Fit</button>
</div>
<canvas id="map" tabindex="0" aria-label="Map of the robots; the tables hold the results"></canvas>
<div id="legend"></div>
<div id="timeline">
<button id="play" type="button">Play</button>
<label>Speed <select id="speed"><option>0.5</option><option>1</option><option>2</option>
<option>5</option><option>10</option><option>30</option></select></label>
<input id="seek" type="range" min="0" max="1" step="0.01" value="0" aria-label="Time in seconds">
<output id="at">0.0 s</output>
<span id="runs" hidden><select id="run-shown"></select><button id="run-before"></button>
<button id="run-after"></button></span>
</div>
</div>
"""


def report_of(
    folder: Path,
    metrics: Sequence[Metric] | None = None,
    seed: int | None = None,
    variant: str | None = None,
) -> str:
    """The report of the experiment in `folder`, as HTML.

    `metrics`: the metrics that are shown first; None: a default choice. `seed` and `variant` choose
    the run to play; by default a typical run of the first variant. ConfigError if there is no such
    experiment or run, SwarmError if no run has finished.
    """
    results = load_results(folder)
    manifest = read_manifest(folder)
    if not results.runs:
        raise SwarmError(f"{folder}: no run has finished: nothing to report")
    first_metrics, other_metrics = shown_metrics(results, metrics)
    source = _source(folder, results, metrics, seed, variant)  # of the run to play
    # Id, title and HTML; `page` leaves out a section without HTML.
    sections = [
        ("results", "Results", _results(results, first_metrics, other_metrics)),
        ("differences", "Differences", differences_tables(results, first_metrics)),
        ("figures", "Figures", figures_html(figures_of(folder, metrics))),
        ("contacts", "Contacts", contacts_table(results)),
    ]
    player = None
    if source is not None:
        assert source.playback is not None  # only sources of a live swarm have none
        player = player_of(source)
        run_text = f"The run of {source.playback.run}"
        played = player_section(run_text, player.period) + events_table(source.marks())
        sections.append(("run", "One run", played))
    sections += [
        ("scenario", "Scenario", _scenario(results, manifest)),
        ("again", "How to make it again", _again(folder, manifest)),
        ("manifest", "Made with", manifest_table(manifest)),
    ]
    return page(
        title=Path(results.plan.scenario).stem,
        sentence=sentence_of(results, metrics),
        question=_question(manifest),
        summary=_summary(results, manifest),
        sections=sections,
        data=data_element("summary", json.dumps(results.document(), allow_nan=False)),
        player=player,
    )


def page(
    *,
    title: str,
    question: str,
    summary: str,
    sections: Sequence[tuple[str, str, str]],
    sentence: str = "",
    data: str = "",
    player: Player | None = None,
) -> str:
    """The HTML of a report: one page with styles, data and scripts inside.

    `sentence`: the answer in short; `question`: the text below. `sections`: id, title and HTML of
    each; a section without HTML is left out. `data`: further elements as HTML, such as those of
    `data_element`. `player`: the data of the run that the section of `player_section` plays.
    """
    code = ""
    if player is not None:
        data += data_element("run-data", player.data)
        code = f'<script type="module">\n{script()}\n</script>'
    templates = files("swarmd.sim.report") / "page"
    section_elements = [
        f'<section id="{name}"><h2>{escape(head)}</h2>\n{body}\n</section>'
        for name, head, body in sections
        if body
    ]
    return Template((templates / "report.html").read_text(encoding="utf-8")).substitute(
        title=escape(title),
        sentence=f'<p id="sentence">{escape(sentence)}</p>' if sentence else "",
        question=escape(question),
        summary=escape(summary),
        style=(templates / "report.css").read_text(encoding="utf-8"),
        sections="\n".join(section_elements),
        data=data,
        script=code,
    )


def player_section(what: str, period: float) -> str:
    """The elements that the player needs; `period` in s between two samples."""
    return _PLAYER.format(what=escape(what), period=period)


def _source(
    folder: Path,
    results: Results,
    metrics: Sequence[Metric] | None,
    seed: int | None,
    variant: str | None,
) -> Source | None:
    """The run to play: the chosen one, else that nearest to the median; None without traces."""
    if seed is None and variant is None:
        variant = results.variants[0]
        seeds = results.seeds(variant)
        primary = primary_metric(results, metrics)
        if seeds and primary is not None:
            seed = seeds[typical_first(results.metric(primary, variant))[0]]
        try:
            return source_of(folder, seed, variant or None)
        except SwarmError:  # traces were not kept
            return None
    return source_of(folder, seed, variant)


def _question(manifest: Manifest) -> str:
    text = str(manifest.variants[0].effective.get("description") or "")
    return " ".join(text.split())


def _summary(results: Results, manifest: Manifest) -> str:
    duration = manifest.variants[0].effective.get("duration", 0.0)
    many = f"{len(results.variants)} variants, " if len(results.variants) > 1 else ""
    failed = f", {len(results.failures)} failed" if results.failures else ""
    runs = f"{many}{len(results.runs)} of {len(results.plan.runs)} runs{failed}"
    made = f"made with swarmd {manifest.made_with.get('swarmd', '')}, {manifest.created}"
    return f"{runs} of {duration:g} s; {made}"


def sentence_of(results: Results, metrics: Sequence[Metric] | None) -> str:
    """The answer in short, such as `gathering: 17 of 20 against 0 of 20`; empty without values.

    It tells the metric that ranks runs, and without `metrics` an event if it happened. Of more than
    two variants it tells the least and the greatest.
    """
    metric = primary_metric(
        results, metrics or [METRICS["consensus_time"], METRICS["gather_time"]]
    ) or primary_metric(results, None)
    if metric is None:
        return ""
    found = [
        (*_outcome(results.metric(metric, name), metric), name)
        for name in results.variants
        if results.seeds(name)
    ]
    chosen = found if len(found) < 3 else [min(found), max(found)]
    texts = [f"{text} ({name})" if name else text for _, text, name in chosen]
    return f"{metric.event or label_of(metric.name)}: {' against '.join(texts)}"


def _outcome(values: Array, metric: Metric) -> tuple[float, str]:
    """The share of runs with an event or a true value, else the mean; and its text."""
    known = values[np.isfinite(values)]
    if metric.is_time_to_event or metric.unit == YES_OR_NO:
        count = known.size if metric.is_time_to_event else int(known.sum())
        return count / values.size, f"{count} of {values.size}"
    mean = float(known.mean()) if known.size else math.nan
    return mean, f"{number(mean)} {'' if metric.unit == 'share' else metric.unit}".strip()


def _results(results: Results, first: Sequence[Metric], others: Sequence[Metric]) -> str:
    parts = []
    fewest = min((len(results.seeds(name)) for name in results.variants), default=0)
    if fewest == 1:
        parts.append("<p><b>Only one run</b>: there are no intervals.</p>")
    elif fewest < FEW:
        parts.append(f"<p><b>Only {fewest} runs</b>: intervals of so few are too narrow.</p>")
    for run, why in list(results.failures.items())[:5]:
        parts.append(f"<p>Failed: {escape(run)}: {escape(why)}</p>")
    for name in results.variants:
        if not results.seeds(name):
            parts.append(f"<h3>{escape(name)}</h3><p>No run has finished.</p>")
            continue
        parts.append(f"<h3>{escape(name)}</h3>" if name else "")
        parts.append(metrics_table(results, name, first) if first else "")
        if others:
            parts.append("<details><summary>All other metrics</summary>")
            parts.append(f"{metrics_table(results, name, others)}</details>")
    parts.append(
        '<p class="narrow dim">A wider window shows median, least, largest and runs too.</p>'
    )
    parts.append(f'<p class="dim">95 % intervals: {escape(METHOD)}.</p>')
    return "\n".join(part for part in parts if part)


def _scenario(results: Results, manifest: Manifest) -> str:
    swept = "; ".join(
        f"{key}: {', '.join(map(str, values))}" for key, values in results.plan.sweep.items()
    )
    text = text_of(_given(dict(manifest.variants[0].effective)), width=90)
    which = f"<p>Swept: {escape(swept)}.</p>" if swept else ""
    head = "The scenario of the first variant" if swept else "The whole scenario"
    return f"{which}<details><summary>{head}</summary><pre>{escape(text)}</pre></details>"


def _given(value: Any) -> Any:
    """The value without keys that are null."""
    if isinstance(value, dict):
        return {key: _given(inner) for key, inner in value.items() if inner is not None}
    return [_given(inner) for inner in value] if isinstance(value, list) else value


def _again(folder: Path, manifest: Manifest) -> str:
    place = shlex.quote(str(folder))
    lines = [
        *([shlex.join(manifest.command)] if manifest.command else []),
        f"swarmctl exp rerun {place}   # repeats it, bit by bit",
        f"swarmctl exp report {place}   # this report",
    ]
    return f"<pre>{escape(chr(10).join(lines))}</pre>"


def data_element(name: str, text: str) -> str:
    """An HTML element with the id `name` that holds the JSON `text` for scripts.

    `<` is escaped, so that no text in the JSON, such as `<!--` or `</script`, changes where the
    element ends.
    """
    escaped = text.replace("<", "\\u003c")
    return f'<script type="application/json" id="{name}">{escaped}</script>\n'
