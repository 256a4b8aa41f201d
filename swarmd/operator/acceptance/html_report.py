"""The report of an acceptance test as one HTML page: the verdict first, then all steps."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

from swarmd.core.values import Array
from swarmd.operator.acceptance.evidence import Samples
from swarmd.operator.acceptance.result_file import AcceptanceRecord, StepResult
from swarmd.operator.acceptance.steps import PARTS
from swarmd.operator.acceptance.verdict import Result

_SIDE = 320  # px of a map
_SPAN = 6.0  # m that a map shows, at most
_COLOURS = {Result.PASS: "#2e7d32", Result.FAIL: "#c62828", Result.NOT_SHOWN: "#777777"}
_STYLE = (
    "body{font:15px sans-serif;max-width:62em;margin:2em auto;padding:0 1em}"
    "table{border-collapse:collapse;width:100%}td,th{padding:.3em .5em;text-align:left;"
    "border-top:1px solid #ddd;vertical-align:top}small{color:#555}"
    "th{width:10%}th:first-child,th:last-child{width:35%}td:nth-child(2){white-space:nowrap}"
    # A telephone of 360 px: the cells of a step below each other.
    "@media(max-width:45em){th{display:none}tr,td{display:block}td{border:0;padding:.1em .3em}"
    "tr{border-top:1px solid #ddd;padding:.4em 0}}"
)
_NONE = "<tr><td colspan=5>no step of this part was asked yet</tr>"


def page(record: AcceptanceRecord, samples: Mapping[str, Samples]) -> str:
    """The page; `samples`: of the steps that have a recording, for their maps."""
    title = f"Acceptance test of {record.robot}"
    versions = ", ".join(f"{name} {version}" for name, version in record.versions.items())
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p><b>{escape(record.headline)}</b></p>",
        f"<p>{escape(record.platform)}, driver {escape(record.driver)}, {escape(record.began)};"
        f" {escape(versions)}</p>",
    ]
    for part, words in PARTS.items():
        rows = [_row(step) for step in record.steps if step.id.startswith(part)]
        heads = "<tr><th>step<th>verdict<th>figure<th>bound<th>reason</tr>"
        parts.append(f"<h2>{part}: {words}</h2><table>{heads}{''.join(rows) or _NONE}</table>")
    missing = [step for step in record.steps if step.verdict.result is Result.NOT_SHOWN]
    lines = "".join(
        f"<li>{escape(f'{one.id} {one.name}: {one.verdict.reason}')}" for one in missing
    )
    parts.append(f"<h2>Not shown, and why</h2><ul>{lines or '<li>nothing'}</ul>")
    parts.append("<h2>Ways by odometry, and the first scan of each</h2>")
    parts += [_map(record, id, one) for id, one in samples.items() if one.odometry]
    view = "<meta name=viewport content='width=device-width'>"
    head = f"<meta charset=utf-8>{view}<title>{escape(title)}</title><style>{_STYLE}</style>"
    return f"<!doctype html><html lang=en><head>{head}</head><body>{''.join(parts)}</body></html>\n"


def _row(step: StepResult) -> str:
    verdict = step.verdict
    moves = f"<br><small>{escape(step.moves)}</small>" if step.moves else ""
    cells = (
        f"{escape(f'{step.id} {step.name}')}<br><small>{escape(step.why)}</small>{moves}",
        f"<b style='color:{_COLOURS[verdict.result]}'>{verdict.result}</b>",
        *map(escape, (verdict.figure, verdict.bound, verdict.reason)),
    )
    return f"<tr>{''.join(f'<td>{cell}' for cell in cells)}</tr>"


def _map(record: AcceptanceRecord, id: str, samples: Samples) -> str:
    """A map in the frame of the first pose: the way, and the returns of the first scan."""
    name = next(step.name for step in record.steps if step.id == id)
    rows = [(one.pose.x, one.pose.y) for _, one in samples.odometry]
    first = samples.odometry[0][1].pose
    turn = np.array(
        ((np.cos(first.yaw), -np.sin(first.yaw)), (np.sin(first.yaw), np.cos(first.yaw)))
    )
    way = _pixels((np.array(rows) - rows[0]) @ turn)
    line = " ".join(f"{x:.0f},{y:.0f}" for x, y in way)
    dots = ""
    if samples.scans:
        scan = samples.scans[0][1]
        is_seen = np.isfinite(scan.ranges) & (scan.ranges > 0.0)
        bearings = scan.bearings[is_seen]
        ranges = scan.ranges[is_seen]
        points = _pixels(np.stack((ranges * np.cos(bearings), ranges * np.sin(bearings)), axis=1))
        dots = "".join(f"<circle cx='{x:.0f}' cy='{y:.0f}' r='1'/>" for x, y in points)
    return (
        f"<svg width='{_SIDE}' height='{_SIDE}' role='img'><title>{escape(f'{id} {name}')}</title>"
        f"<text x='4' y='14' font-size='12'>{escape(f'{id} {name}')}</text>{dots}"
        f"<polyline points='{line}' fill='none' stroke='#c62828' stroke-width='2'/></svg>"
    )


def _pixels(points: Array) -> list[tuple[float, float]]:
    """Places in px of points (n, 2) in m; x ahead is up, and the middle is the first pose."""
    scale = _SIDE / _SPAN
    return [(0.5 * _SIDE - scale * y, 0.5 * _SIDE - scale * x) for x, y in points.tolist()]
