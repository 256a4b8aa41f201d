"""The tables of a report, as HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.sim.experiments import sweep
from swarmd.sim.experiments.compare import DIFFERENCE_HEADER, Difference, difference_row
from swarmd.sim.experiments.manifest import Manifest
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.statistics import HEADER, summary_rows
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.metrics.contacts import contact_list
from swarmd.sim.metrics.metric import Metric
from swarmd.sim.plots.select import RUN_BY_RUN

MAX_CONTACTS = 30
MAX_EVENTS = 100
_CONTACTS = ("robot_contacts", "arena_contacts", "box_contacts")


def table(head: Sequence[str], rows: Iterable[Sequence[str]], kind: str = "") -> str:
    """A table of cells that are HTML; the first column is text."""
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "\n".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    start = f'<div class="wide"><table class="{kind}"><thead><tr>{top}</tr></thead>'
    return f"{start}<tbody>\n{body}\n</tbody></table></div>"


def metrics_table(results: Results, variant: str, metrics: Sequence[Metric]) -> str:
    """The statistics of metrics, each with its meaning."""
    summaries = results.summary(variant, metrics)
    rows = summary_rows((metric, summaries[metric.name]) for metric in metrics)
    named = zip(metrics, rows, strict=True)
    return table(
        HEADER, [(_meaning(metric), *map(escape, row[1:])) for metric, row in named], "metrics"
    )


def shown_metrics(
    results: Results, asked: Sequence[Metric] | None
) -> tuple[list[Metric], list[Metric]]:
    """The metrics to show first, `asked` or by default, and the rest of those with a value."""
    measured = [
        metric
        for metric in map(results.about, results.metrics)
        if np.isfinite(results.metric(metric)).any()
    ]
    first = asked
    if first is None:
        first = [
            metric for metric in measured if metric.name in RUN_BY_RUN or metric.name not in METRICS
        ]
    names = {metric.name for metric in first}
    return list(first), [metric for metric in measured if metric.name not in names]


def differences_tables(results: Results, metrics: Sequence[Metric]) -> str:
    """How variants of a sweep differ from the first, and how two swept keys add up; or empty."""
    names = [name for name in results.variants if results.seeds(name)]
    if len(names) < 2:
        return ""
    parts = [
        _plain(*sweep.variants_table(results, metrics)),
        f'<p class="dim">{sweep.READING}</p>',
    ]
    if effects := sweep.factors(results, metrics):
        rows = [row for effect in effects for row in sweep.marginal_rows(effect)]
        parts += ["<h3>Each swept key</h3>", _plain(sweep.MARGINAL_HEADER, rows)]
        rows = [sweep.interaction_row(effect) for effect in effects]
        parts += ["<h3>Interaction of both keys</h3>", _plain(sweep.INTERACTION_HEADER, rows)]
    for name, differences in zip(names[1:], sweep.first_and_others(results, metrics), strict=True):
        is_paired = any(difference.is_paired for difference in differences)
        samples = "paired by seed" if is_paired else "independent samples"
        parts.append(f"<h3>B: {escape(name)}, and A: {escape(names[0])}</h3>")
        text = "95 % bootstrap intervals of B - A; p with Holm's correction for all variants"
        parts += [f'<p class="dim">{samples}; {text}</p>', _differences(differences)]
    return "\n".join(parts)


def _plain(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are texts."""
    cells = [(_breakable(first), *map(escape, rest)) for first, *rest in rows]
    return table(head, cells, "differences")


def contacts_table(results: Results) -> str:
    """The first contacts of all runs as HTML; empty if no run had a contact.

    Contacts are listed from traces. Runs without a trace are only counted.
    """
    runs_with_contacts = {
        row["run"]
        for row in results.rows
        if any((row.get(metric) or 0.0) > 0.0 for metric in _CONTACTS)
    }
    if not runs_with_contacts:
        return ""
    rows = []
    for run in results.runs:
        if run.id not in runs_with_contacts:
            continue
        try:
            trace = results.traces[run.id]
        except SwarmError:  # the trace was not kept
            continue
        for contact in contact_list(trace):
            sides = ((contact.a, contact.is_a_moving), (contact.b, contact.is_b_moving))
            moving = ", ".join(name for name, is_moving in sides if is_moving)
            cells = (
                run.title,
                f"{contact.start:.1f} s",
                f"{contact.a}, {contact.b}",
                moving or "-",
            )
            rows.append((*map(escape, cells), f"{contact.closing_speed:.3f} m/s"))
    text = f"{len(runs_with_contacts)} of {len(results.runs)} runs had contacts"
    if len(rows) > MAX_CONTACTS:
        text += f"; the first {MAX_CONTACTS} of {len(rows)} are listed"
    head = ("RUN", "TIME", "BETWEEN", "MOVING", "CLOSING SPEED")
    return f"<p>{text}.</p>\n{table(head, rows[:MAX_CONTACTS], 'contacts')}"


def events_table(marks: Sequence[tuple[float, str, Sequence[str]]]) -> str:
    """The first events of a run as HTML, from `Source.marks`; empty without any."""
    rows = [
        (f"{at:.1f} s", escape(", ".join(robots)), escape(text))
        for at, text, robots in marks[:MAX_EVENTS]
    ]
    return table(("TIME", "ROBOTS", "EVENT"), rows, "contacts") if rows else ""


def manifest_table(manifest: Manifest) -> str:
    """What the runs were made with."""
    seeds = ", ".join(map(str, manifest.seeds))
    rows = [("created", manifest.created), ("scenario", manifest.scenario), ("seeds", seeds)]
    rows += [("part", str(manifest.shard))] if manifest.shard else []
    for name, state in manifest.git.items():
        if state is not None:
            changed = ", with changes that are not committed" if state.is_dirty else ""
            rows.append((f"git commit of {name}", f"{state.commit}{changed}"))
    rows += [*manifest.made_with.items()]
    rows += [(f"plugin {name}", digest) for name, digest in manifest.plugins.items()]
    body = "".join(
        f'<tr><td>{escape(name)}</td><td class="long">{escape(value)}</td></tr>'
        for name, value in rows
    )
    return f'<div class="wide"><table class="manifest"><tbody>{body}</tbody></table></div>'


def _meaning(metric: Metric) -> str:
    return f"{_breakable(metric.name)}<small>{escape(metric.meaning)}</small>"


def _breakable(name: str) -> str:
    """A name whose line may break after each underscore."""
    return escape(name).replace("_", "_<wbr>")


def _differences(differences: Sequence[Difference]) -> str:
    rows = [
        (_breakable(difference.metric), *map(escape, difference_row(difference)[1:]))
        for difference in differences
    ]
    return table(DIFFERENCE_HEADER, rows, "differences")
