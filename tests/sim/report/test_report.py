"""Reports: what they hold, that they need nothing else, and that their player plays."""

from __future__ import annotations

import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from swarmd.sim.cli.exp import exp
from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.experiments.store import Row
from swarmd.sim.report.html import data_element, sentence_of
from swarmd.sim.report.player import player_of, script
from swarmd.sim.view.trace_source import source_of
from tests.support.chromium import Browser, Page

pytestmark = pytest.mark.long

METRICS = ("mean_distance_to_centroid_late", "minimum_gap")
SCENARIO = """\
description: "Do two Burgers <gather>?"
duration: 2
realism: ideal
arena:
  size: [5, 5]
  boxes: [{name: crate, at: [2, 2], size: [0.4, 0.4], mass: 2.0}]
groups:
  all: {platform: burger, count: 2, prefix: r, pattern: attraction, start: {layout: random}}
events: [{at: 1, fault: {radio: mute}, robots: r-02}]
"""


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an experiment of two variants, with a report."""
    folder = tmp_path_factory.mktemp("report")
    (folder / "duo.yaml").write_text(SCENARIO)
    sweep = {"groups.all.parameters.spacing": [0.6, 1.2]}
    simulate(folder / "duo.yaml", 2, sweep=sweep, out=folder / "runs")
    words = ["report", str(folder / "runs"), "--metrics", ",".join(METRICS)]
    done = CliRunner().invoke(exp, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert (folder / "runs" / "report.html").stat().st_size < 3e6
    return folder / "runs"


@pytest.fixture(scope="module")
def document(experiment: Path) -> Document:
    found = Document()
    found.feed((experiment / "report.html").read_text())
    found.close()
    return found


def test_the_sections_and_the_question(document: Document) -> None:
    wanted = ["results", "differences", "figures", "run", "scenario", "again", "manifest"]
    assert document.sections == wanted  # without contacts: there were none
    assert document.text_of("question") == "Do two Burgers <gather>?"
    assert document.open_elements == []
    assert document.text_of("sentence").startswith("mean distance to centroid late: ")
    assert "detailssummaryThe scenario of the first variant" in document.outline


def test_the_events_of_the_run_are_listed(experiment: Path) -> None:
    html = (experiment / "report.html").read_text()
    assert "<td>1.0 s</td><td>r-02</td><td>fault radio mute</td>" in html


@pytest.mark.parametrize(
    ("metric", "values", "sentence"),
    [
        (
            "gather_time",
            {"a": [20.0] * 17 + [None] * 3, "b": [None] * 20},
            "gathering: 17 of 20 (a) against 0 of 20 (b)",
        ),
        ("one_cluster_at_end", {"": [1.0, 0.0, 1.0, 1.0]}, "one cluster at end: 3 of 4"),
        (
            "path_length",
            {"a": [1.0, 3.0], "b": [6.0, 4.0], "c": [2.0, 4.0]},
            "path length: 2 m (a) against 5 m (b)",
        ),
        ("path_length", {"": [None]}, ""),
    ],
)
def test_the_sentence_tells_the_answer(
    metric: str, values: dict[str, list[float | None]], sentence: str
) -> None:
    seeds = tuple(range(max(map(len, values.values()))))
    plan = Plan("x", seeds, tuple(Variant(name, {}, {"duration": 60.0}) for name in values))
    rows = [Row(run, {metric: values[run.variant.name][run.seed]}, 0.1) for run in plan.runs]
    results = Results(Path("x"), plan, rows, {}, (metric,))
    assert sentence_of(results, [results.about(metric)]) == sentence


def test_the_sentence_of_a_report_without_metrics_is_of_an_event() -> None:
    plan = Plan("x", (1, 2), (Variant("", {}, {"duration": 60.0}),))
    rows = [Row(run, {"path_length": 1.0, "gather_time": 9.0}, 0.1) for run in plan.runs]
    results = Results(Path("x"), plan, rows, {}, ("path_length", "gather_time"))
    assert sentence_of(results, None) == "gathering: 2 of 2"


def test_the_numbers_are_those_of_exp_show(document: Document, experiment: Path) -> None:
    done = CliRunner().invoke(exp, ["show", str(experiment), "-o", "json"])
    shown = json.loads(done.stdout)
    embedded = json.loads(document.scripts["summary"])
    assert embedded["variants"] == shown["variants"]
    rows = iter(document.rows)
    for variant in shown["variants"]:
        for name in METRICS:
            cells = next(row for row in rows if row[0].startswith(name))
            one = variant["metrics"][name]
            low, high = one["mean_interval"]
            assert cells[1] == one["unit"]
            assert cells[2] == f"{one['mean']:.4g}"
            assert cells[3] == f"{low:.4g} to {high:.4g}"


def test_a_report_needs_nothing_else(document: Document) -> None:
    for name, value in document.references:
        assert value.startswith("data:"), (name, value[:80])
    code = document.scripts["module"] + document.style
    assert not re.search(r"https?:|url\(|@import|fetch\(|WebSocket", code)


def test_a_player_holds_the_run(experiment: Path) -> None:
    source = source_of(experiment, 1, "spacing=0.6")
    data = json.loads(player_of(source).data)
    assert data["count"] == 21  # ten a second
    poses = np.frombuffer(base64.b64decode(data["poses"]), "<i2").reshape(21, 3, 3).astype(float)
    assert len(data["boxes"]) == 1
    assert source.playback is not None
    for k in (0, 10, 20):
        source.playback.seek(k * data["period"])
        _, places = source.frame()
        found = poses[k, :2, :2] * data["unit"] + data["centre"]
        assert np.abs(found - places[:, 1:3]).max() < 1e-3
        turn = poses[k, :2, 2] * np.pi / 32767 - places[:, 3]
        assert np.abs(np.angle(np.exp(1j * turn))).max() < 1e-3
    assert data["rows"][0]["r-01"]["state"]


def test_every_module_of_the_player_is_inside() -> None:
    code = script()
    assert "modules['map.js'] = " in code
    assert not re.search(r"^(import|export)\b", code, re.MULTILINE)


def test_a_folder_without_an_experiment_is_one_line(tmp_path: Path) -> None:
    done = CliRunner().invoke(exp, ["report", str(tmp_path)])
    assert done.exit_code != 0
    assert "no experiment" in str(done.exception)
    assert list(tmp_path.iterdir()) == []
    done = CliRunner().invoke(exp, ["report", str(tmp_path / "nothing")])
    assert "no experiment" in str(done.exception)
    (tmp_path / "tb3-01-00001.mcap").touch()  # a folder of recordings
    done = CliRunner().invoke(exp, ["report", str(tmp_path)])
    assert "no messages in this recording" in str(done.exception)


@pytest.mark.integration
@pytest.mark.long
def test_the_player_plays_from_a_file(a_browser: Browser, experiment: Path) -> None:
    with a_browser.page() as page:
        page.open((experiment / "report.html").as_uri())
        start = page.evaluate(_PLACES)
        assert np.isfinite(np.array(start, dtype=float)).all()
        page.click("#play")
        page.until("swarm.model.time === swarm.model.playback.duration", "the end of the run")
        page.until("document.getElementById('play').textContent === 'Play'", "pauses at the end")
        assert np.abs(np.array(page.evaluate(_PLACES)) - start).max() > 0.01
        page.evaluate(
            "(() => { const seek = document.getElementById('seek'); seek.value = 0;"
            " seek.dispatchEvent(new Event('input')); })()"
        )
        assert page.evaluate(_PLACES) == start
        assert page.evaluate("swarm.model.boxes.length") == 1
        is_open = "document.querySelector('#scenario details').open"
        assert page.evaluate(is_open) is False
        page.evaluate("void dispatchEvent(new Event('beforeprint'))")
        assert page.evaluate(is_open) is True  # paper cannot unfold it
        _fits(page, 1400)
        page.resize(390, 844, is_phone=True)
        _fits(page, 390)
        assert page.errors == []


_PLACES = "[...swarm.model.robots.values()].map((robot) => [robot.x, robot.y])"


def _fits(page: Page, width: int) -> None:
    """Only parts of the page scroll sideways, not the page."""
    assert page.evaluate("document.documentElement.scrollWidth") <= width


class Document(HTMLParser):
    """What tests ask of a report."""

    def __init__(self) -> None:
        super().__init__()
        self.open_elements: list[str] = []
        self.sections: list[str] = []
        self.references: list[tuple[str, str]] = []
        self.rows: list[list[str]] = []
        self.scripts: dict[str, str] = {}
        self.style = ""
        self.outline = ""  # the details, and their summaries
        self._texts: dict[str, str] = {}
        self._id = self._script = ""

    def text_of(self, name: str) -> str:
        return self._texts[name]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values: dict[str, Any] = dict(attrs)
        if tag not in ("meta", "link", "img", "input", "wbr"):
            self.open_elements.append(tag)
        if tag == "section":
            self.sections.append(values["id"])
        self.references += [(tag, str(v)) for k, v in attrs if k in ("src", "href", "srcset")]
        if tag in ("details", "summary"):
            self.outline += tag
        self._id = values.get("id") or ""
        if tag == "script":
            self._script = values.get("id") or values["type"]
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open_elements.pop() == tag

    def handle_data(self, data: str) -> None:
        inside = self.open_elements[-1] if self.open_elements else ""
        if inside == "script":
            self.scripts[self._script] = self.scripts.get(self._script, "") + data
        elif inside == "style":
            self.style += data
        elif inside in ("td", "th"):
            self.rows[-1][-1] += data
        elif inside == "summary":
            self.outline += data
        elif inside == "p":
            self._texts[self._id] = self._texts.get(self._id, "") + data


def test_no_text_ends_the_element_that_holds_it_or_keeps_it_open() -> None:
    text = "</script><!--<script>"
    inside = data_element("x", json.dumps(text)).partition(">")[2].rpartition("</script>")[0]
    assert "<" not in inside
    assert json.loads(inside) == text
