"""What the page shows where, in a real browser with robots whose messages are fed to the server."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.core.messages import Health, Reason, State
from tests.support.chromium import FOUND, Page
from tests.support.processes import wait_until
from tests.view.test_fleet import ESTOP, ready, shown

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(FOUND is None, reason="no Chromium here"),
]

WIDTHS = [(390, 844), (1280, 720), (1920, 1080)]
SHARE = (
    "(() => { const b = document.getElementById('map').getBoundingClientRect();"
    " return b.width * b.height / innerWidth / innerHeight; })()"
)
LINE = "document.querySelector('.answer .line').textContent"
ENTRIES = "[...document.querySelectorAll('#legend > *')].map((one) => one.textContent)"


def box_of(page: Page, selector: str) -> Any:
    return page.evaluate(
        f"(() => {{ const b = document.querySelector('{selector}').getBoundingClientRect();"
        " return [b.x, b.y, b.width, b.height]; })()"
    )


@pytest.mark.parametrize(("width", "height"), WIDTHS)
def test_the_map_has_most_of_the_window_and_the_estop_never_moves(
    page: Page, capsys: pytest.CaptureFixture[str], width: int, height: int
) -> None:
    with shown(7, capsys, ["tb3-005"]) as (swarm, (address,)):
        page.resize(width, height, is_phone=width < 900)
        ready(page, address, 7)
        assert page.evaluate(SHARE) >= 0.65
        assert page.evaluate("document.documentElement.scrollWidth") == width
        place, strip = box_of(page, "#estop"), box_of(page, "#answers")
        x, y = place[0] + place[2] / 2, place[1] + place[3] / 2
        for _ in range(2):  # the second press hits although a banner is shown and a robot silent
            page.mouse(x, y)
            page.until(f"!{ESTOP}.hidden && {ESTOP}.textContent.includes('tb3-005')", "a banner")
            page.evaluate("swarm.actions.act('run', {targets: ['tb3-001'], pattern: 'disperson'})")
            page.until(f"{LINE}.includes('disperson')", "an answer")
            page.evaluate("swarm.model.select(['tb3-001'])")
            assert box_of(page, "#estop") == place
            assert box_of(page, "#answers") == strip
        page.evaluate("swarm.actions.isStopping = false; swarm.actions.hideEstop()")
        wait_until(lambda: swarm.states["tb3-001"] is State.ESTOPPED, "stopped")
        assert page.errors == []


def test_one_key_leaves_the_map_and_its_legend_alone(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (_, (address,)):
        ready(page, address, 3)
        page.until(f"{ENTRIES}.length > 0", "the legend")
        seen = (
            "['#legend', '#estop', 'header', '#time', '#tools']"
            ".filter((one) => document.querySelector(one).checkVisibility())"
        )
        page.key("f")
        page.until(f"{SHARE} === 1", "the whole window")
        assert page.evaluate(seen) == ["#legend"]
        page.key("f")
        page.until(f"{SHARE} < 0.9", "all again")
        assert page.evaluate(seen) == ["#legend", "#estop", "header", "#time", "#tools"]


def test_refusals_are_one_line_with_what_to_do(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(7, capsys) as (swarm, (address,)):
        ready(page, address, 7)
        page.click("#run-open")
        page.type("#pattern", "disperson")
        page.click("#run")
        wanted = "run: 7 refused: no pattern 'disperson'"
        page.until(f'{LINE}.startsWith("{wanted}")', "one reason for seven robots")
        page.click(".proposal")
        page.until("document.getElementById('pattern').value === 'dispersion'", "chosen")
        page.click("#estop")
        page.until(f"{ESTOP}.className === 'good'", "stopped")
        page.click("#run")
        page.until(f"{LINE}.includes('reset it first')", "a refusal")
        page.click(".proposal")
        page.until("document.querySelector('.proposal').matches('.armed')", "asks")
        assert set(swarm.states.values()) == {State.ESTOPPED}
        page.click(".proposal")
        wait_until(lambda: set(swarm.states.values()) == {State.IDLE}, "reset")
        assert "`" not in page.evaluate("document.getElementById('answers').textContent")


def test_states_are_told_apart_and_counted(page: Page, capsys: pytest.CaptureFixture[str]) -> None:
    with shown(6, capsys) as (swarm, (address,)):
        ready(page, address, 6)
        swarm.change("tb3-001", State.RUNNING, reason=Reason.NO_REQUESTED_COMMAND)
        swarm.change("tb3-002", State.RUNNING, reason=Reason.NO_SCAN)
        swarm.change("tb3-003", State.STOPPED)
        swarm.change("tb3-004", State.ESTOPPED)
        counted = ["estopped1", "held1", "stopped1", "running2", "at rest1"]
        page.until(f"{ENTRIES}.join() === '{','.join(counted)}'", "the legend")
        counts = "6 robots: 1 estopped, 1 held, 1 stopped, 2 running, 1 at rest"
        page.until(f"document.getElementById('counts').textContent === '{counts}'", "the counts")
        page.click("#legend button")
        assert page.evaluate("[...swarm.model.selected]") == ["tb3-004"]
        page.evaluate("swarm.map.colourBy('protection')")
        # Grey robots and signs have entries whatever the colours mean.
        page.until(
            f"{ENTRIES}.includes('no protection2') && {ENTRIES}.includes('estopped1')", "all"
        )


def test_a_base_that_is_lost_is_told_at_once_while_its_robot_is_estopped(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (swarm, (address,)):
        ready(page, address, 3)
        swarm.change("tb3-002", State.ESTOPPED)
        page.until("swarm.model.robots.get('tb3-002').row.state === 'estopped'", "stopped")
        assert page.evaluate("document.getElementById('lost').hidden") is True
        health = Health(driver="no such device", driver_up=False)
        swarm.change("tb3-002", State.ESTOPPED, health=health)
        notice = "document.getElementById('lost').textContent"
        page.until(f"{notice}.includes('tb3-002') && {notice}.includes('no such device')", "told")
        page.until(f"{ENTRIES}.includes('base lost1')", "the legend")
        swarm.change("tb3-002", State.ESTOPPED)
        page.until("document.getElementById('lost').hidden", "found again")


def test_names_of_many_robots_are_those_below_the_mouse(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(16, capsys) as (_, (address,)):
        ready(page, address, 16)
        named = "swarm.map.named([...swarm.model.robots.values()]).map((one) => one.name)"
        page.evaluate("swarm.map.fit()")
        assert page.evaluate(named) == []
        page.evaluate("swarm.map.hovered = swarm.model.robots.get('tb3-007')")
        assert page.evaluate(named) == ["tb3-007"]


def test_parameters_are_a_form_of_the_pattern(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    described = [
        {
            "name": "drive",
            "summary": "Drives straight ahead.",
            "platform": "waffle_pi",
            "params": [
                {
                    **{"name": "speed", "type": "float", "unit": "m/s", "ge": -2.0, "le": 2.0},
                    **{"default": 0.26, "description": "speed", "choices": []},
                    **{"is_required": False, "is_optional": False, "is_own": True},
                }
            ],
        }
    ]
    with shown(2, capsys, describe=lambda platform: described) as (_, (address,)):
        ready(page, address, 2)
        page.click("#run-open")
        row = "#pattern-list [data-name=drive]"
        page.until(f"document.querySelector('{row}').textContent.includes('straight')", "a line")
        page.click(row)
        field = "document.querySelector('#params [name=speed]')"
        page.until(f"{field}.placeholder === '0.26'", "the default")
        unit = page.evaluate("document.querySelector('#params label').textContent")
        assert "m/s" in unit
        assert "-2 to 2" in unit
        page.type("#params [name=speed]", "9")
        page.click("#run")
        page.until(f"!{field}.checkValidity()", "out of bounds")
        assert page.evaluate("document.querySelectorAll('.answer').length") == 0
        page.evaluate(f"{field}.value = '-0.1'")
        assert page.evaluate("swarm.actions.form.params()") == "speed=-0.1"
        page.click("#run")
        page.until(f"{LINE}.startsWith('run: 2 targeted, 2 applied')", "sent")


def test_a_page_looks_back_and_starts_nothing_from_there(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (swarm, (address,)):
        ready(page, address, 3)
        known = page.evaluate("swarm.model.plots.times.length")
        page.until(f"swarm.model.plots.times.length > {known}", "a moment with all robots")
        page.evaluate("window.moment = swarm.model.plots.times.at(-1)")
        swarm.change("tb3-001", State.ESTOPPED)
        page.until("swarm.model.marks.some(([, , robots]) => robots.includes('tb3-001'))", "marks")
        page.until("swarm.model.robots.get('tb3-001').row.state === 'estopped'", "stopped")
        page.until("swarm.plots.latest() > window.moment + 2", "the moment is past")
        page.evaluate("swarm.plots.to(window.moment)")
        page.until("swarm.model.robots.get('tb3-001').row.state === 'running'", "the past")
        assert page.evaluate("document.getElementById('past-note').hidden") is False
        assert page.evaluate("swarm.model.plots.values.speed.length") > 2
        page.evaluate("swarm.actions.act('run', {targets: ['tb3-002'], pattern: 'dispersion'})")
        page.until(f"{LINE}.includes('not sent')", "refused by the page")
        # The server refuses it, too, by the number of the old picture.
        page.until("swarm.plots.latest() > window.moment + 5", "an old picture")
        page.evaluate(
            "(() => { const past = swarm.model.past; swarm.model.past = null;"
            " swarm.actions.act('run', {targets: ['tb3-002'], pattern: 'dispersion'});"
            " swarm.model.past = past; })()"
        )
        page.until(f"{LINE}.includes('came too late')", "refused by the server")
        page.click("#stop")
        wait_until(lambda: swarm.states["tb3-002"] is State.STOPPED, "a stop is sent")
        page.click("#past-now")
        page.until("swarm.model.robots.get('tb3-002').row.state === 'stopped'", "the present")
