"""What the page shows where, in a real browser with robots whose messages are fed to the server."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from swarmd.core.incident import IncidentKind
from swarmd.core.messages import Code, FenceSummary, Health, Reason, Reply, State
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.session import TargetedView
from swarmd.operator.session.targets import Targets
from swarmd.operator.verbs.push.ask import Push
from swarmd.operator.view import commander
from swarmd.operator.view.commander import LiveCommander
from tests.operator.view.test_fleet import ESTOP, ready, shown
from tests.operator.view.test_page_hand import FakeHand
from tests.support.chromium import FOUND, Page
from tests.support.fed_swarm import PATTERNS
from tests.support.incidents import ID
from tests.support.processes import CAP, wait_until

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(FOUND is None, reason="no Chromium here"),
]

LOST_BASE = Health(driver="/dev/ttyACM0: no such device", driver_up=False)
WIDTHS = [(390, 844), (1280, 720), (1920, 1080)]
FRAMES = "new Promise((seen) => requestAnimationFrame(() => requestAnimationFrame(seen)))"
SHARE = (
    "(() => { const b = document.getElementById('map').getBoundingClientRect();"
    " return b.width * b.height / innerWidth / innerHeight; })()"
)
LINE = "document.querySelector('.answer .line').textContent"
ENTRIES = "[...document.querySelectorAll('#legend > *')].map((one) => one.textContent)"
OTHER = "ba9876543210"
KEPT_MARKS = "Object.defineProperty(model, 'marks', { get: () => marks, set() {} });"
"""The server's own marks do not replace those of a test."""
CHIPS = "[...document.querySelectorAll('#chips > *')].map((one) => one.textContent)"


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
            "['#legend', '#chips', '#estop', '#time', '#tools']"
            ".filter((one) => document.querySelector(one).checkVisibility())"
        )
        page.key("f")
        page.until(f"{SHARE} === 1", "the whole window")
        assert page.evaluate("document.getElementById('caveat').checkVisibility()")
        assert page.evaluate(seen) == ["#legend"]
        told = "getComputedStyle(document.getElementById('legend'), '::before').content"
        page.until(f"{told} === '\"attraction 1, dispersion 1, 1 more\"'", "what they run")
        page.key("f")
        page.until(f"{SHARE} < 0.9", "all again")
        assert page.evaluate(seen) == ["#chips", "#estop", "#time", "#tools"]


def test_refusals_are_one_line_with_what_to_do(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(7, capsys) as (swarm, (address,)):
        ready(page, address, 7)
        page.evaluate(
            "swarm.actions.act('run', {targets: swarm.actions.named(), pattern: 'disperson'})"
        )
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
        page.until(f"{CHIPS}.join() === '{','.join(counted)}'", "the chips")
        page.click("#chips button")
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
    drives = [
        {
            "name": "drive",
            **{"group": "move together", "missing": [], "refused": "", "report_units": {}},
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
    with shown(2, capsys, describe=lambda platform: drives) as (_, (address,)):
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


COMMANDS_GO = (
    "String([document.getElementById('targets').textContent.startsWith('Commands go to'),"
    " ...['run-open', 'run', 'reset', 'estop-reset', 'param', 'set-labels'].map("
    " (id) => document.getElementById(id).getAttribute('aria-disabled'))])"
)
"""Whether the page says that commands go to robots, and whether buttons look unusable."""


def test_a_chosen_file_is_pushed_whole_and_a_wrong_one_is_refused_in_one_line(
    page: Page,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pushed: list[tuple[Push, tuple[str, ...]]] = []

    def push_to(push: Push, targeted: TargetedView, targets: Targets) -> Outcome:
        pushed.append((push, targets.names))
        return Outcome({"tb3-001": Reply(id="1", robot="tb3-001", code=Code.APPLIED)})

    monkeypatch.setattr(commander, "push_to", push_to)
    for limit in ("MAX_INPUT_GAP", "MAX_LATENESS"):  # of commands on a machine that stands still
        monkeypatch.setattr(f"swarmd.operator.session.clocks.{limit}", CAP)
    file = tmp_path / "own.py"
    file.write_bytes("# é\n".encode() * 20_000)
    large = tmp_path / "large.py"
    large.write_bytes(bytes(2**20 + 1))
    with shown(2, capsys) as (_, (address,)):
        page.resize(390, 844, is_phone=True)
        ready(page, address, 2)
        page.evaluate("swarm.model.select(['tb3-001'])")
        page.click("#run-open")
        page.evaluate("document.getElementById('push-box').open = true")
        page.choose("#push-file", large)
        page.evaluate("document.getElementById('push').click()")  # not by place: answers move it
        page.until(f"{LINE}.includes('1048576')", "a refusal")
        assert pushed == []
        page.choose("#push-file", file)
        page.evaluate("document.getElementById('push-canary').click()")
        page.evaluate("document.getElementById('push').click()")
        page.until(f"{LINE}.startsWith('push: 1 targeted, 1 applied')", "pushed")
        ((push, names),) = pushed
        assert (push.source.name, push.source.code) == ("own", file.read_bytes())
        assert (push.canary, push.replace, push.rerun, names) == (1, False, False, ("tb3-001",))
        page.until("document.getElementById('run').textContent === 'Run own'", "to be run next")
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        assert page.errors == []


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
        page.until(f"{COMMANDS_GO} === 'false,true,true,true,true,true,true'", "no command goes")
        page.click("#run-open")
        page.until(f"{LINE} === 'run: not sent: the map shows the past; go back to now'", "why")
        assert page.evaluate("document.getElementById('commands').hidden") is True
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
        # Once tb3-001 is stopped, too, there is nothing to reset.
        page.until(f"{COMMANDS_GO} === 'true,false,false,true,false,false,false'", "commands go")


NOTICES = ("banner", "estop-state", "lost")
PANELS = ("", "commands", "look", "list-pane", "commands list-pane", "time", "answers")
OPEN = (
    "(name) => { if (name === 'answers') return swarm.actions.answers.open(true);"
    " swarm.actions.answers.open(false);"
    " for (const one of ['commands', 'look', 'list-pane', 'time'])"
    " swarm.panels.open(one, name.includes(one)); }"
)
HIT = """(id) => {
  const box = document.getElementById(id).getBoundingClientRect();
  const { left, right, top, bottom } = box, d = 9;
  return [left + d, right - d].flatMap((x) => [[x, top + d], [x, bottom - d]])
    .every(([x, y]) => {
      const hit = document.elementFromPoint(x, y);
      return hit && hit.closest('#notices > *') === document.getElementById(id);
    });
}"""
SIZES = [(320, 640), *WIDTHS]


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_no_panel_covers_a_notice(
    page: Page, capsys: pytest.CaptureFixture[str], width: int, height: int
) -> None:
    with shown(7, capsys, ["tb3-003"]) as (swarm, (address,)):
        page.resize(width, height, is_phone=width < 900)
        ready(page, address, 7)
        swarm.change("tb3-002", State.ESTOPPED, health=LOST_BASE)
        page.click("#estop")
        page.until(f"{ESTOP}.textContent.includes('tb3-003') && !{ESTOP}.hidden", "not acked")
        page.until("!document.getElementById('lost').hidden", "a lost base")
        page.evaluate(
            "(() => { const one = document.getElementById('banner');"
            " one.textContent = 'No link'; one.hidden = false; })()"
        )
        for panel in PANELS:
            page.evaluate(f"({OPEN})('{panel}')")
            covered = [one for one in NOTICES if not page.evaluate(f"({HIT})('{one}')")]
            assert (panel, covered) == (panel, [])
        assert page.evaluate("document.documentElement.scrollWidth") == width
        page.click("#estop-end")


@pytest.mark.parametrize("width", [320, 1280])
def test_the_question_of_a_reset_is_whole(
    page: Page, capsys: pytest.CaptureFixture[str], width: int
) -> None:
    with shown(40, capsys) as (_, (address,)):
        page.resize(width, 640, is_phone=width < 900)
        ready(page, address, 40)
        page.evaluate("swarm.model.select(['tb3-001', 'tb3-002'])")
        page.evaluate("swarm.model.select([])")
        page.click("#estop")
        page.until(f"{ESTOP}.className === 'good'", "stopped")
        page.click("#reset")
        for name in ("stop", "reset"):
            fits = (
                f"(() => {{ const one = document.getElementById('{name}');"
                " return one.scrollWidth <= one.clientWidth"
                " && one.scrollHeight <= one.clientHeight; })()"
            )
            assert page.evaluate(fits), name
        assert page.evaluate("document.getElementById('reset').matches('.armed')")


TARGETS = """[...document.querySelectorAll(
  'button, select, input:not([type=checkbox]), summary, label.toggle, tbody tr[data-name]')]
  .filter((one) => one.checkVisibility()).map((one) => [one.id || one.className || one.textContent,
    one.getBoundingClientRect()]).filter(([, box]) => box.height < 44 || box.width < 44)
  .map(([name, box]) => `${name} ${box.width} x ${box.height}`)"""


def test_what_a_finger_touches_is_44_px_and_the_phone_names_swarm_and_silent_robots(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(7, capsys, ["tb3-005"]) as (swarm, (address,)):
        page.resize(390, 844, is_phone=True)
        ready(page, address, 7)
        swarm.change("tb3-002", State.STOPPED)
        page.until(f"{CHIPS}[0] === 'silent1: tb3-005'", "silent")
        assert page.evaluate("(({ scrollWidth: w, clientWidth: h }) => w <= h)(title)")
        x, _, width, _ = box_of(page, "#chips > *")
        assert 0 <= x < x + width <= 390
        assert page.evaluate("document.getElementById('title').textContent") == "fed"
        for panel in PANELS[:-1]:
            page.evaluate(f"({OPEN})('{panel}')")
            if panel == "list-pane":
                page.until("document.querySelectorAll('tr[data-name]').length > 3", "cards")
                card = "document.querySelector('tr[data-name=\"tb3-001\"]').innerText"
                assert "attraction" in page.evaluate(card)
            assert (panel, page.evaluate(TARGETS)) == (panel, [])
        page.evaluate("swarm.model.select(['tb3-001'])")
        page.until("document.getElementById('detail-why').textContent !== ''", "details")
        assert page.evaluate(TARGETS) == []


@pytest.mark.parametrize(("width", "height"), WIDTHS[1:])
def test_the_table_has_the_patterns_and_whole_reasons(
    page: Page, capsys: pytest.CaptureFixture[str], width: int, height: int
) -> None:
    with shown(4, capsys) as (swarm, (address,)):
        page.resize(width, height)
        ready(page, address, 4)
        swarm.change("tb3-002", State.RUNNING, reason=Reason.NO_REQUESTED_COMMAND)
        swarm.change("tb3-003", State.STOPPED, detail="by anna@desk", since=130.0)
        swarm.change("tb3-004", State.ESTOPPED, detail="by anna@desk", since=130.0)
        page.click("#robots-open")
        cell = "document.querySelector('tr[data-name=\"{}\"] td.{}')"
        first, why = cell.format("tb3-001", "pattern"), cell.format("tb3-003", "why")
        page.until(f"{first}.checkVisibility() && {first}.textContent === 'attraction'", "pattern")
        page.until(f"{why}.textContent === 'stopped by anna, 2 min ago'", "since when")
        assert page.evaluate("document.querySelector('th.battery').checkVisibility()")
        for name in ("tb3-002", "tb3-003", "tb3-004"):
            why = cell.format(name, "why")
            page.until(f"{why}.textContent.length > 20", f"the reason of {name}")
            page.until(f"{why}.scrollWidth <= {why}.clientWidth", f"the whole reason of {name}")


def test_the_card_of_a_silent_robot_says_since_when_and_its_last_state(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (swarm, (address,)):
        ready(page, address, 3)
        swarm.silent.add("tb3-002")
        page.evaluate("swarm.model.select(['tb3-002'])")
        why = "document.getElementById('detail-why').textContent"
        page.until(f"{why}.includes('failed: it may still move); last state: running')", "told")
        page.until("swarm.model.robots.get('tb3-002').detail.why.includes('forget')", "a detail")
        page.until(f"!{why}.includes('Members')", "no command of swarmctl")


def test_the_table_of_a_small_phone_has_rows_below_notices(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(7, capsys, ["tb3-003"]) as (swarm, (address,)):
        page.resize(320, 640, is_phone=True)
        ready(page, address, 7)
        swarm.change("tb3-002", State.ESTOPPED, health=LOST_BASE)
        page.click("#estop")
        page.until(f"!{ESTOP}.hidden", "not acked")
        page.until("document.getElementById('label').options.length > 1", "labels")
        page.evaluate("swarm.panels.open('list-pane', true)")
        bar = "document.querySelector('#list-pane .bar')"
        page.until(f"{bar}.offsetHeight > 0 && {bar}.offsetHeight < 70", "a bar of one line")
        assert page.evaluate(f"{bar}.scrollWidth <= {bar}.clientWidth")


LONG = "Drives to other robots and stands next to them; alone it searches for others. " * 2


def described(platform: str) -> list[dict[str, Any]]:
    """Patterns in two groups, of which one cannot run on any platform."""
    about: dict[str, Any] = {"platform": platform, "params": [], "missing": [], "refused": ""}
    about["report_units"] = {"votes": "votes", "opinion": "m"}
    return [
        {**about, "name": "drive", "summary": "Drives straight ahead.", "group": "move together"},
        {**about, "name": "attraction", "summary": LONG, "group": "gather"},
        {**about, "name": "dispersion", "summary": "Spreads.", "group": "spread"},
        {**about, "name": "best_of_n", "summary": "Decides.", "group": "decide"},
        {
            **{**about, "missing": ["gripper"]},
            **{"name": "flocking", "summary": "Flies.", "group": "move together"},
        },
    ]


def test_the_search_finds_what_is_shown_and_arms_no_unknown_pattern(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    names = (*PATTERNS, "random_walk")
    with shown(2, capsys, patterns=names) as (_, (address,)):
        ready(page, address, 2)
        page.click("#run-open")
        found = (
            "[...document.querySelectorAll('#pattern-list [data-name]')].map(o => o.dataset.name)"
        )
        armed = "!document.getElementById('run').disabled"

        def type_name(text: str) -> None:
            page.evaluate("document.getElementById('pattern').value = ''")
            page.type("#pattern", text)

        type_name("random w")
        assert page.evaluate(found) == ["random_walk"]
        assert page.evaluate(armed) is False
        type_name("Random Walk")
        assert page.evaluate(armed) is True
        assert page.evaluate("document.getElementById('run').textContent") == "Run random walk"
        assert page.evaluate("swarm.actions.form.chosen.name") == "random_walk"
        type_name("zzz")
        assert page.evaluate(found) == []
        assert page.evaluate(armed) is False
        assert "zzz" in page.evaluate("document.getElementById('pattern-list').textContent")
        page.click("#pattern-list p button:last-child")  # a pattern that only robots have
        assert page.evaluate("swarm.actions.form.chosen.name") == "zzz"
        type_name("disperson")
        assert page.evaluate(armed) is False
        page.click("#run")
        page.click("#pattern-list p button")
        assert page.evaluate("swarm.actions.form.chosen.name") == "dispersion"
        assert page.evaluate("document.querySelectorAll('.answer').length") == 0
        page.click("#run")
        page.until(f"{LINE}.startsWith('run: 2 targeted, 2 applied')", "sent")
        assert page.evaluate("document.getElementById('commands').hidden") is True


def test_patterns_are_grouped_with_recent_ones_and_greyed_with_the_reason(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    names = (*PATTERNS, "best_of_n")
    with shown(2, capsys, describe=described, patterns=names) as (_, (address,)):
        ready(page, address, 2)
        page.click("#run-open")
        heads = "[...document.querySelectorAll('#pattern-list h3')].map((o) => o.textContent)"
        wanted = ["gather", "spread", "move together", "decide"]
        page.until(f"{heads}.join() === '{','.join(wanted)}'", "groups")
        groups = "[...document.querySelector('[role=listbox]').children].map((o) => o.role)"
        assert page.evaluate(groups) == ["group"] * len(wanted)
        grey = "document.querySelector('#pattern-list [data-name=flocking]')"
        assert page.evaluate(f"{grey}.getAttribute('aria-disabled')") == "true"
        assert "lacks gripper" in page.evaluate(f"{grey}.textContent")
        page.click("#pattern-list [data-name=flocking]")
        assert page.evaluate("document.getElementById('run').disabled") is True
        page.click("#pattern-list [data-name=drive]")
        page.click("#run")
        page.until(f"{heads}.join() === '{','.join(['run last', *wanted])}'", "what ran last")


COVERED = """(() => {
  const found = [...document.querySelectorAll(%s)].filter((one) => one.offsetHeight);
  return found.filter((one) => {
    const b = one.getBoundingClientRect();
    return document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2) !== one;
  }).map((one) => one.id);
})()"""


@pytest.mark.parametrize("width", [320, 390, 1280])
def test_hints_cover_no_tool_of_the_map(
    page: Page, capsys: pytest.CaptureFixture[str], width: int
) -> None:
    with shown(3, capsys) as (_, (address,)):
        page.resize(width, 800, is_phone=width < 901)
        ready(page, address, 3)
        page.evaluate("document.getElementById('align').click()")
        page.until("!document.getElementById('forget').hidden", "a tool more")
        page.until(f"{COVERED % repr('#tools button')}.length === 0", "all tools are free")
        page.evaluate("document.getElementById('align').click()")
        page.evaluate("document.getElementById('large').click()")
        page.until(f"{COVERED % repr('#tools button')}.length === 0", "all tools are free")


@pytest.mark.parametrize(("width", "height"), [(320, 640), (390, 844)])
def test_the_card_of_a_robot_covers_no_robot_on_a_phone(
    page: Page, capsys: pytest.CaptureFixture[str], width: int, height: int
) -> None:
    places = (
        "[...swarm.model.robots.values()].map((one) => {"
        " const box = document.getElementById('map').getBoundingClientRect();"
        " const [x, y] = swarm.map.toScreen(one.x, one.y).map((it) => it / swarm.map.ratio);"
        " const hints = document.getElementById('hints').getBoundingClientRect();"
        " return box.y + y > hints.bottom && document.elementFromPoint(box.x + x, box.y + y)?.id;"
        " }).every((id) => id === 'map')"
    )
    with shown(7, capsys) as (swarm, (address,)):
        page.resize(width, height, is_phone=True)
        ready(page, address, 7)
        swarm.change("tb3-005", State.ESTOPPED, health=LOST_BASE)
        page.until("!document.getElementById('lost').hidden", "a notice")
        page.evaluate(
            "(() => { const hint = document.getElementById('overload');"
            " hint.textContent = 'This computer is overloaded (load 19, 2 cores): robots are late';"
            " hint.hidden = false; })()"
        )
        page.until(places, "all robots are seen")
        page.evaluate("document.getElementById('detail-more').open = true")
        page.evaluate("swarm.model.select(['tb3-003'])")
        page.until("document.getElementById('detail-pane').offsetHeight > 100", "a card")
        page.until(places, "all robots are seen beside the card")
        page.evaluate("document.getElementById('detail-close').click()")
        page.until("document.getElementById('detail-pane').offsetHeight === 0", "no card")
        page.until(places, "all robots are seen")


def test_a_selection_does_not_move_the_map_of_a_wide_window(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (_, (address,)):
        ready(page, address, 3)
        # Hints that appear may move the map: none appears from here on.
        page.until("document.getElementById('caveat').checkVisibility()", "the caveat")
        page.evaluate("document.getElementById('overload').style.display = 'none'")
        view = "[...swarm.map.centre, swarm.map.scale]"
        page.evaluate(f"{FRAMES}.then(() => null)")
        before = page.evaluate(f"(() => {{ swarm.map.fit(); return {view}; }})()")
        near = "swarm.model.robots.get('tb3-002').offset = [0.2, 0, 0]"
        page.evaluate(f"(() => {{ {near}; swarm.model.select(['tb3-003']); }})()")
        page.until("document.getElementById('detail-pane').offsetHeight > 0", "a card")
        page.evaluate(f"{FRAMES}.then(() => null)")
        assert page.evaluate(view) == before


def test_the_map_fits_again_when_a_robot_leaves_it_until_the_view_is_moved(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (_, (address,)):
        ready(page, address, 3)
        page.evaluate("swarm.panels.open('commands', true)")
        far = "const robot = swarm.model.robots.get('tb3-002'); robot.offset = [40, 0, 0];"
        page.evaluate(f"(() => {{ swarm.map.fit(); {far} }})()")
        place = "swarm.map.toScreen(robot.x, robot.y)[0] / swarm.map.ratio"
        is_seen = (
            "(() => { const robot = swarm.model.robots.get('tb3-001');"
            f" return {place} > document.getElementById('commands').offsetWidth; }})()"
        )
        page.until("!swarm.map.isLeft([...swarm.model.robots.values()])", "all are seen again")
        assert page.evaluate(is_seen)
        page.evaluate("swarm.map.isTouched = true")
        scale = page.evaluate("swarm.map.scale")
        page.evaluate(f"(() => {{ {far.replace('40', '400')} }})()")
        page.until("swarm.map.isLeft([...swarm.model.robots.values()])", "out of view")
        page.evaluate("swarm.map.draw()")
        assert page.evaluate("swarm.map.scale") == scale


def test_the_map_of_a_small_phone_has_its_whole_width(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(7, capsys) as (_, (address,)):
        page.resize(320, 640, is_phone=True)
        ready(page, address, 7)
        page.until("swarm.map.insets[0] > 44", "tools above")
        assert box_of(page, "#tools")[3] < 60  # one line, of buttons of 44 px
        assert page.evaluate("swarm.map.insets[3]") == 0
        page.resize(640, 320, is_phone=True)
        page.until("swarm.map.insets[3] > 44", "tools at the right, of a phone that lies")


def test_a_narrow_axis_of_time_has_its_labels_inside(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(2, capsys) as (_, (address,)):
        page.resize(320, 640, is_phone=True)
        ready(page, address, 2)
        page.click("#time-open")
        # Texts of the axis with their horizontal extent, of an axis of five minutes.
        page.evaluate(
            "(() => { const { plots } = swarm, fill = plots.ctx.fillText; window.texts = [];"
            " plots.range = () => [0.3, 299.9];"
            " plots.ctx.fillText = function (text, x, y) {"
            " const { width } = this.measureText(text);"
            " const left = { left: x, right: x - width, center: x - width / 2 }[this.textAlign];"
            " window.texts.push([String(text), left, left + width]);"
            " fill.call(this, text, x, y); };"
            " plots.draw(); })()"
        )
        texts = {text: ends for text, *ends in page.evaluate("window.texts")}
        width = page.evaluate("document.getElementById('plots').clientWidth")
        assert {"now", "-2 min", "-4 min"} <= texts.keys()
        assert max(right for _, right in texts.values()) <= width


def test_a_column_without_values_is_not_shown(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (_, (address,)):
        ready(page, address, 3)
        page.click("#robots-open")
        page.until("document.querySelector('th.pattern').offsetWidth > 0", "of running robots")
        page.click("#estop")
        page.until("document.querySelector('th.pattern').offsetWidth === 0", "none runs")
        assert page.evaluate("document.querySelector('th.battery').offsetWidth") > 0


def test_the_map_alone_has_a_way_back(page: Page, capsys: pytest.CaptureFixture[str]) -> None:
    with shown(2, capsys) as (_, (address,)):
        ready(page, address, 2)
        page.click("#present")
        assert page.evaluate(COVERED % repr("#present-end")) == []
        page.click("#present-end")
        assert page.evaluate("document.body.matches('.present')") is False


def test_reported_numbers_have_the_units_of_their_patterns(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(1, capsys, describe=described) as (_, (address,)):
        ready(page, address, 1)
        page.until("swarm.model.unitOf('report:votes') === 'votes'", "described")
        page.evaluate("swarm.model.select(['tb3-001'])")
        values = "document.getElementById('detail-values').textContent"
        page.until(f"{values}.includes('votes0 votes') && {values}.includes('opinionA')", "values")
        page.evaluate("swarm.map.colourBy('report:votes')")
        page.until(f"{ENTRIES}.includes('0.00 votes')", "the legend")
        assert page.evaluate("swarm.plots.text('report:votes', 2)") == "2 votes"
        assert page.evaluate("swarm.plots.text('speed', 0.1)") == "0.1 m/s"
        assert page.evaluate("swarm.model.unitOf('readings:battery')") == ""


@pytest.mark.parametrize(("width", "height"), WIDTHS[:2])
def test_the_whole_fence_is_on_the_map_and_in_the_legend(
    page: Page, capsys: pytest.CaptureFixture[str], width: int, height: int
) -> None:
    corners = ((-9.0, -7.0), (9.0, -7.0), (9.0, 7.0), (-9.0, 7.0))
    inner = ((6.0, 4.0), (8.0, 4.0), (8.0, 6.0))
    fence = FenceSummary(frame="mocap", polygons=(corners, inner))
    with shown(3, capsys) as (swarm, (address,)):
        for name in swarm.names[:2]:  # equal fences are drawn once
            swarm.change(name, State.RUNNING, fence=fence)
        page.resize(width, height, is_phone=width < 900)
        ready(page, address, 3)
        page.until(f"{ENTRIES}.includes('fence') && {ENTRIES}.includes('keep out')", "the legend")
        assert page.evaluate("swarm.map.fencesOf().length") == 1
        page.evaluate("swarm.map.fit()")
        places = page.evaluate(
            "swarm.map.fencesOf()[0].flat().map(([x, y]) => swarm.map.toScreen(x, y))"
            ".map(([x, y]) => [x / swarm.map.ratio, y / swarm.map.ratio])"
        )
        for x, y in places:
            assert 0 < x < page.evaluate("swarm.map.canvas.clientWidth")
            assert 0 < y < page.evaluate("swarm.map.canvas.clientHeight")
        pixel = (
            "(() => { swarm.map.draw(); const [x, y] = swarm.map.toScreen(%f, %f);"
            " return [...swarm.map.ctx.getImageData(x, y, 1, 1).data]; })()"
        )
        assert page.evaluate(pixel % (7.6, 4.5)) != page.evaluate(pixel % (5.6, 4.5))
        assert page.errors == []


def test_after_an_estop_the_page_tells_one_truth(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (_, (address,)):
        ready(page, address, 3)
        page.until("swarm.plots.valueAt('active', swarm.plots.latest()) !== null", "running")
        page.evaluate("swarm.actions.act('run', {targets: ['tb3-001'], pattern: 'disperson'})")
        page.until(f"{LINE}.includes('disperson')", "a failure")
        # From the acknowledgement on, before any status: what robots publish meanwhile is old.
        page.evaluate(
            "(() => { const { model, actions } = swarm, estopped = actions.estopped;"
            " actions.estopped = function (message) { estopped.call(this, message);"
            " if (message.is_final) window.told = [...model.robots.values()]"
            ".map((one) => one.row.state); }; })()"
        )
        page.click("#estop")
        page.until("window.told", "acknowledged")
        assert page.evaluate("window.told") == ["estopped"] * 3
        assert page.evaluate(LINE).startswith("estop: 3 targeted, 3 applied")
        old = "{kind: 'rows', rows: {'tb3-001': {state: 'running'}}}"
        page.evaluate(
            "(() => { const one = swarm.model.robots.get('tb3-001');"
            " one.acked = {row: {state: 'estopped'}, before: 'running', until: Infinity};"
            f" swarm.model.rows({old}, performance.now()); }})()"
        )
        assert page.evaluate("swarm.model.robots.get('tb3-001').row.state") == "estopped"
        page.until("swarm.plots.valueAt('active', swarm.plots.latest()) === null", "none runs")


def test_places_of_odometry_have_a_caveat_until_they_are_aligned(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(2, capsys) as (_, (address,)):
        ready(page, address, 2)
        caveat = "document.getElementById('caveat')"
        page.until(f"{caveat}.checkVisibility()", "the caveat")
        assert page.evaluate("document.getElementById('map').matches('.unaligned')")
        page.evaluate("swarm.model.robots.get('tb3-001').offset = [1, 0, 0]")
        page.until(f"{caveat}.hidden", "aligned")
        assert not page.evaluate("document.getElementById('map').matches('.unaligned')")


def test_near_events_have_one_tick_and_words_for_people(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(2, capsys) as (_, (address,)):
        ready(page, address, 2)
        page.until("swarm.plots.latest() > 0 && swarm.plots.left", "a plot")
        text = "stop to 2 robots, by anna@desk, handed on by 127.0.0.1: applied: commanded zero"
        told = page.evaluate(
            "(() => { const { model, plots } = swarm, now = plots.latest();"
            f" model.marks = [0, 0.1, 0.2].map((at) => [now + at - 1, '{text}', ['a'], 1]);"
            " const [tick] = plots.ticks((at) => 10 * (at - now + 1), now - 2, now);"
            " plots.tell(tick.marks); return document.getElementById('mark-text').textContent; })()"
        )
        assert told.count("stop to 2 robots by anna: applied") == 3


def test_an_incident_is_a_mark_of_its_own_and_has_the_line_to_fetch_it(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    text = f"incident {ID} of tb3-001: fault: a pattern failed"
    with shown(2, capsys) as (_, (address,)):
        ready(page, address, 2)
        page.until("swarm.plots.latest() > 0 && swarm.plots.left", "a plot")
        colours = page.evaluate(
            "(() => { const { model, plots } = swarm, now = plots.latest(), drawn = [];"
            f" model.marks = [[now - 9, 'stop', ['a'], 1], [now - 1, '{text}', ['a'], 1]];"
            " const fill = plots.ctx.fill;"
            " plots.ctx.fill = function () { drawn.push(this.fillStyle); fill.call(this); };"
            " const x = (at) => 50 * (at - now + 20);"
            " plots.drawMarks(x, now - 20, now, 9, 16, '#111111', '#ff0000');"
            " plots.ctx.fill = fill; return drawn; })()"
        )
        assert colours == ["#111111", "#ff0000"]
        lines = page.evaluate(
            "(() => { swarm.detail.drawValues({"
            f" events: [['3 s ago', '{text}'], ['4 s ago', 'stop']] }});"
            " return [...document.querySelectorAll('#events code')].map((one) => one.textContent);"
            " })()"
        )
        assert lines == [f"swarmctl incidents fetch {ID}"]


def test_incidents_are_chips_and_a_click_shows_that_instant(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    """Robots hear of one incident at several times; words of robots and operators are text."""
    evil = "<img src=x onerror=window.hacked=1><b>x</b>"
    with shown(2, capsys) as (_, (address,)):
        ready(page, address, 2)
        page.until("swarm.plots.latest() > 0 && swarm.plots.left", "a plot")
        page.evaluate("swarm.panels.open('time', true)")
        page.evaluate(
            "(() => { const { model, plots } = swarm, now = plots.latest();"
            f" const marks = [[now - 3, 'incident {OTHER} of tb3-002: mark: {evil}', ['b'], 1],"
            f" [now - 8, 'incident {ID} of tb3-001: driver_lost: no cable', ['a'], 1],"
            f" [now - 9, 'incident {ID} of tb3-001: driver_lost: no cable', ['b'], 1],"
            " [now - 1, 'stop by anna', ['a'], 1]];"
            f" {KEPT_MARKS} window.now = now; plots.chips.draw(); }})()"
        )
        chips = page.evaluate(
            "[...document.querySelectorAll('#incidents button')].map((one) =>"
            " [one.dataset.incident, one.children[1].textContent, one.children[2].textContent])"
        )
        assert chips == [[ID, "tb3-001", "driver lost"], [OTHER, "tb3-002", "mark"]]
        assert evil in page.evaluate("document.querySelector('#incidents button:last-child').title")
        assert page.evaluate("document.querySelectorAll('#incidents img').length") == 0
        assert page.evaluate("window.hacked === undefined")
        assert "2" in page.evaluate("document.getElementById('time-open').textContent")
        page.evaluate("window.seen = []; swarm.plots.to = (at) => seen.push(at - now)")
        page.click(f"#incidents [data-incident='{ID}']")
        assert -10.5 < page.evaluate("seen[0]") < -8.5, "the first that heard of it"


def test_an_incident_of_an_older_robot_has_its_words_in_place_of_its_kind(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(2, capsys) as (_, (address,)):
        ready(page, address, 2)
        page.until("swarm.plots.latest() > 0 && swarm.plots.left", "a plot")
        page.evaluate(
            "(() => { const { model, plots } = swarm;"
            f" const marks = [[1, 'incident {ID} of tb3-001: it: shook', ['a'], 1]];"
            f" {KEPT_MARKS} plots.chips.draw(); }})()"
        )
        chip = "document.querySelector('#incidents button').children[2].textContent"
        assert page.evaluate(chip) == "it: shook"
        for kind in IncidentKind:
            line = f"incident {ID} of tb3-001: {kind}: it shook"
            read = f"import('./states.js').then(({{ incidentOf }}) => incidentOf('{line}'))"
            found = page.evaluate(read)
            assert (found["kind"], found["text"]) == (kind.value, "it shook")


def test_one_button_is_the_primary_action_of_an_emergency_stop(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    """The banner offers the reset of the robots that need one; the button for all is plain."""
    primary = (
        "(() => { const wanted = getComputedStyle(document.documentElement)"
        ".getPropertyValue('--accent').trim(), probe = document.createElement('i');"
        " probe.style.color = wanted; document.body.append(probe);"
        " const colour = getComputedStyle(probe).color; probe.remove();"
        " const found = [...document.querySelectorAll('button')].filter((one) =>"
        " one.checkVisibility() && getComputedStyle(one).backgroundColor === colour);"
        " return [document.getElementById('estop-reset').checkVisibility(),"
        " ...found.map((one) => one.id)]; })()"
    )
    with shown(3, capsys) as (_, (address,)):
        ready(page, address, 3)
        # In one go: the next message of the server has the true states.
        state = "swarm.model.robots.get('tb3-002').row.state = '{}'; swarm.actions.mark();"
        faulted = page.evaluate(f"{state.format('faulted')} {primary}")
        estopped = page.evaluate(f"{state.format('estopped')} {primary}")
        assert faulted == [False, "reset"]
        assert estopped == [True]


def test_on_a_phone_most_of_the_height_is_the_map_also_under_an_emergency_stop(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(7, capsys) as (_, (address,)):
        page.resize(390, 844, is_phone=True)
        ready(page, address, 7)
        pane = "document.getElementById('map-pane').getBoundingClientRect()"
        assert page.evaluate(f"{pane}.height / innerHeight") >= 0.7
        page.click("#estop")
        # Until all have acknowledged, the banner names some of them in more lines.
        page.until(f"{ESTOP}.textContent.includes('all 7 robots')", "the banner")
        assert page.evaluate(f"{pane}.top / innerHeight") <= 0.22
        assert page.evaluate(f"{pane}.height / innerHeight") >= 0.64


def test_robots_without_a_shared_frame_are_laid_out_side_by_side(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    """Odometry begins at 0 where a robot was switched on, so all would lie on one place."""
    with shown(4, capsys) as (_, (address,)):
        ready(page, address, 4)
        least = page.evaluate(
            "(() => { const { model } = swarm, view = new DataView(new ArrayBuffer(20 + 4 * 16));"
            " model.past = null; view.setUint32(16, 4, true);"
            " for (let i = 0; i < 4; i++) view.setUint32(20 + 16 * i, i, true);"
            " for (const robot of model.robots.values()) robot.layout = null;"
            " model.frame(view, performance.now());"
            " const places = [...model.robots.values()].map(({ x, y }) => [x, y]);"
            " return Math.min(...places.flatMap(([x, y], i) => places.slice(i + 1)"
            ".map(([a, b]) => Math.hypot(x - a, y - b)))); })()"
        )
        assert least == pytest.approx(2.0)


def test_the_slider_has_the_axis_of_the_plots(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(2, capsys) as (_, (address,)):
        ready(page, address, 2)
        page.until("swarm.plots.left > 0", "plots")
        ends = page.evaluate(
            "['plots', 'back'].map((id) => document.getElementById(id).getBoundingClientRect())"
            ".map((box) => [box.left, box.right])"
        )
        left, right = page.evaluate("[swarm.plots.left, swarm.plots.right]")
        assert ends[1] == pytest.approx([ends[0][0] + left - 8, ends[0][1] - right + 8], abs=1.0)


def test_names_cover_neither_each_other_nor_robots(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(7, capsys) as (_, (address,)):
        ready(page, address, 7)
        boxes = page.evaluate(
            "(() => { const { map, model } = swarm, robots = [...model.robots.values()];"
            " robots.forEach((one, i) => { one.x = 0.4 * (i % 3); one.y = 0.1 * (i - i % 3); });"
            " map.fit(); map.draw(); const boxes = [], { ctx } = map, fill = ctx.fillText;"
            " ctx.fillText = function (text, x, y) { if (/^tb3/.test(text))"
            " boxes.push([x, y, this.measureText(text).width / 2]); fill.call(this, text, x, y); };"
            " map.draw(); delete ctx.fillText;"
            " const places = robots.map((one) => map.toScreen(one.x, one.y));"
            " return [boxes, 0.9 * map.nameSize * map.rem, places]; })()"
        )
        names, high, robots = boxes
        assert names
        for i, (x, y, half) in enumerate(names):
            assert not any(abs(u - x) < half + w and abs(v - y) < high for u, v, w in names[:i])
            assert not any(abs(u - x) < half and abs(v - y) < high for u, v in robots)


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_alarms_come_first_in_their_colours_and_what_runs_is_told(
    page: Page, capsys: pytest.CaptureFixture[str], width: int, height: int
) -> None:
    with shown(7, capsys) as (swarm, (address,)):
        page.resize(width, height, is_phone=width < 900)
        for name in swarm.names:
            swarm.patterns[name] = "flocking"
            swarm.change(name, State.RUNNING)
        ready(page, address, 7)
        told = "document.getElementById('counts')"
        page.until(f"{told}.textContent === '7 robots: flocking 7'", "what they run")
        page.evaluate(f"{FRAMES}.then(() => null)")
        assert page.evaluate(f"{told}.scrollWidth <= {told}.clientWidth")
        swarm.change("tb3-002", State.ESTOPPED)
        swarm.silent.add("tb3-005")
        page.until(f"{CHIPS}.join() === 'silent1: tb3-005,estopped1,running5'", "the chips")
        colours = page.evaluate(
            "[...document.querySelectorAll('#chips > *')].map((one) =>"
            " getComputedStyle(one).backgroundColor)"
        )
        red = page.evaluate("getComputedStyle(document.getElementById('estop')).backgroundColor")
        assert colours[1] == red  # as the emergency stop
        assert len(set(colours)) == 3
        assert "flocking 5" in page.evaluate(f"{told}.textContent")
        swarm.silent.clear()
        swarm.patterns |= {"tb3-001": "attraction", "tb3-003": "drive"}
        for name in ("tb3-001", "tb3-003"):
            swarm.change(name, State.RUNNING)
        wanted = "7 robots: flocking 4, attraction 1, 1 more"
        page.until(f"{told}.textContent === '{wanted}'", "three patterns")
        swarm.patterns |= {"tb3-001": "one_bit_aggregation", "tb3-003": "discussed_dispersion"}
        for name in swarm.names:
            swarm.change(name, State.RUNNING)
        wanted = "7 robots: flocking 5, one bit aggregation 1, 1 more"
        page.until(f"{told}.textContent === '{wanted}' && {CHIPS}.length === 1", "long names")
        page.evaluate(f"{FRAMES}.then(() => null)")
        assert page.evaluate(f"{told}.scrollWidth <= {told}.clientWidth")
        whole = f"{told}.scrollHeight <= {told}.clientHeight + 1"
        assert page.evaluate(whole) or width == 320  # the last words are in the title of the line


def test_the_map_shows_what_the_head_counts_while_no_frame_comes(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (_, (address,)):
        ready(page, address, 3)
        page.until(f"{CHIPS}.join() === 'running3'", "all run")
        page.evaluate(
            "window.drawn = []; const draw = swarm.map.draw;"
            " swarm.map.draw = function () { draw.call(this);"
            " drawn.push(this.heard()[1].length); };"
            " swarm.model.frame = () => {}; swarm.model.rows = () => {};"
        )
        page.until(f"{CHIPS}[0].startsWith('silent3')", "silent")
        page.until("drawn.at(-1) === 3", "drawn as silent, too")
        assert page.errors == []


def test_a_page_that_was_held_up_calls_no_robot_silent(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (_, (address,)):
        ready(page, address, 3)
        page.until(f"{CHIPS}.join() === 'running3'", "all run")
        page.evaluate(
            "window.seen = []; new MutationObserver(() =>"
            " seen.push(document.getElementById('chips').textContent))"
            ".observe(document.getElementById('chips'), {childList: true, subtree: true});"
            " const ends = performance.now() + 6000; while (performance.now() < ends);"
        )
        page.until("swarm.model.age(swarm.model.byIndex[0], performance.now()) < 1", "rows again")
        page.evaluate("new Promise((seen) => setTimeout(seen, 1000)).then(() => null)")
        assert page.evaluate("seen.filter((one) => one.includes('silent'))") == []


CONTRAST = """(selector) => {
  const one = document.querySelector(selector), canvas = new OffscreenCanvas(1, 1).getContext('2d');
  const bright = (...colours) => {
    for (const colour of colours) { canvas.fillStyle = colour; canvas.fillRect(0, 0, 1, 1); }
    const [r, g, b] = [...canvas.getImageData(0, 0, 1, 1).data].slice(0, 3).map((v) => v / 255)
      .map((v) => (v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4));
    return .2126 * r + .7152 * g + .0722 * b + .05;
  };
  const { color, backgroundColor, opacity } = getComputedStyle(one);
  const pale = `color-mix(in srgb, ${color} ${100 * opacity}%, ${backgroundColor})`;
  const [a, b] = [bright(backgroundColor, pale), bright(backgroundColor)];
  return Math.max(a, b) / Math.min(a, b);
}"""
"""The contrast of a text as of WCAG 2.2, 1.4.3, which wants 4.5."""


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (768, 1024), (360, 780)])
def test_the_head_has_words_for_all_states_and_buttons_that_keep_their_places(
    page: Page, capsys: pytest.CaptureFixture[str], width: int, height: int
) -> None:
    with shown(9, capsys) as (swarm, (address,)):
        page.resize(width, height, is_phone=width < 900)
        ready(page, address, 9)
        places = [box_of(page, one) for one in ("#run-open", "#stop", "#reset")]
        swarm.change("tb3-002", State.RUNNING, reason=Reason.NO_SCAN)
        for name, state in (
            ("tb3-001", "ESTOPPED"),
            ("tb3-003", "STOPPED"),
            ("tb3-004", "FAULTED"),
        ):
            swarm.change(name, State[state])
        swarm.change("tb3-006", State.RUNNING, reason=Reason.NO_REQUESTED_COMMAND)
        swarm.silent.add("tb3-005")
        wanted = ["silent", "estopped", "faulted", "held", "stopped", "running", "at rest"]
        labels = "[...document.querySelectorAll('#chips > *')].map((one) => one.ariaLabel)"
        counts = [f"{word}: {3 if word == 'running' else 1}" for word in wanted]
        page.until(f"{labels}.join() === '{','.join(counts)}'", "a name for each chip")
        page.evaluate("swarm.model.select(['tb3-001'])")
        page.until("document.getElementById('reset').ariaDisabled !== 'true'", "a reset is needed")
        assert [box_of(page, one) for one in ("#run-open", "#stop", "#reset")] == places
        page.evaluate(f"{FRAMES}.then(() => null)")
        chips = "document.getElementById('chips')"
        for one in ("scrollWidth <= {0}.clientWidth", "scrollHeight <= {0}.clientHeight"):
            assert page.evaluate(f"{chips}.{one.format(chips)}")
        # Words go one by one, the calm ones first.
        words = "[...document.querySelectorAll('#chips span')].map((one) => one.checkVisibility())"
        seen = page.evaluate(words)
        assert seen == sorted(seen, reverse=True)
        assert sum(seen) >= (3 if width == 360 else 7)
        told = "document.getElementById('counts')"
        assert page.evaluate(f"{told}.scrollWidth <= {told}.clientWidth")
        swarm.change("tb3-001", State.IDLE)
        page.until("document.getElementById('reset').ariaDisabled === 'true'", "no reset")
        for selector in ("#chips .alarm", "#reset"):
            assert page.evaluate(f"({CONTRAST})('{selector}')") >= 4.5


def test_the_table_has_alarms_first_and_tells_a_low_battery(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(4, capsys) as (swarm, (address,)):
        ready(page, address, 4)
        swarm.change("tb3-003", State.ESTOPPED)
        swarm.silent.add("tb3-004")
        page.evaluate("swarm.model.robots.get('tb3-002').row.battery = 0.2")
        page.evaluate("swarm.panels.open('list-pane', true)")
        first = "[...document.querySelectorAll('tr[data-name]')].map((r) => r.dataset.name).join()"
        page.until(f"{first} === 'tb3-003,tb3-004,tb3-001,tb3-002'", "alarms first")
        page.evaluate("swarm.model.robots.get('tb3-002').row.battery = 0.2; swarm.list.draw()")
        cell = "document.querySelector('tr[data-name=tb3-002] .battery').textContent"
        assert page.evaluate(cell) == "20 % low"
        page.click("th.name")
        page.until(f"{first} === 'tb3-001,tb3-002,tb3-003,tb3-004'", "as asked")


PIXELS = """(name) => {
  const { map, model } = swarm, robot = model.robots.get(name);
  map.draw();
  const [x, y] = map.toScreen(robot.x, robot.y), far = Math.round(1.3 * robot.radius * map.scale);
  const { data } = map.ctx.getImageData(x - far, y - far, 2 * far, 2 * far);
  let red = 0;
  for (let i = 0; i < data.length; i += 4) red += data[i] > data[i + 1] + 60 && data[i] > 180;
  return red;
}"""
"""The number of bright red pixels of the map around a robot."""


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_name_of_a_silent_robot_is_no_fainter_than_the_others(
    page: Page, capsys: pytest.CaptureFixture[str], theme: str
) -> None:
    with shown(3, capsys) as (swarm, (address,)):
        ready(page, address, 3)
        if theme == "dark":
            page.evaluate("document.getElementById('dark').click()")
        swarm.silent.add("tb3-002")
        page.until(f"{CHIPS}[0] === 'silent1: tb3-002'", "silent")
        page.evaluate(
            "(() => { const { map } = swarm, fill = map.ctx.fillText; window.inks = {};"
            " map.ctx.fillText = function (text, ...rest) {"
            " window.inks[text] = this.fillStyle; fill.call(this, text, ...rest); };"
            " map.draw(); })()"
        )
        inks = page.evaluate("window.inks")
        wanted = {"light": ("#16191d", "#55606c"), "dark": ("#eef1f4", "#a3afbb")}[theme]
        assert (inks["tb3-002"], inks["tb3-001"]) == wanted


def test_a_robot_that_left_is_no_alarm(page: Page, capsys: pytest.CaptureFixture[str]) -> None:
    with shown(3, capsys) as (swarm, (address,)):
        for name in swarm.names:
            swarm.change(name, State.RUNNING)
        ready(page, address, 3)
        page.evaluate("(() => { trails.click(); swarm.map.fit(); })()")
        swarm.left.add("tb3-002")
        page.until(f"{CHIPS}.join() === 'running2,left1'", "the chips")
        assert page.evaluate(f"({PIXELS})('tb3-002')") == 0
        page.evaluate("swarm.panels.open('list-pane', true)")
        page.until("document.querySelector('tr.stale').innerText.includes('left')", "the row")


def test_a_silent_robot_is_red_on_the_map(page: Page, capsys: pytest.CaptureFixture[str]) -> None:
    with shown(2, capsys) as (swarm, (address,)):
        ready(page, address, 2)
        page.evaluate("(() => { trails.click(); swarm.map.fit(); })()")
        assert page.evaluate(f"({PIXELS})('tb3-002')") == 0
        swarm.silent.add("tb3-002")
        page.until(f"({PIXELS})('tb3-002') > 20", "red")


def test_an_estop_that_stands_has_a_banner_with_its_reset(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (swarm, (address,)):
        ready(page, address, 3)
        assert page.evaluate(f"{ESTOP}.hidden") is True
        why = {"detail": "by anna@desk: a dog is here", "since": 300.0}
        swarm.change("tb3-002", State.ESTOPPED, **why)
        text = "document.getElementById('estop-text').textContent"
        told = "Emergency stop by anna: a dog is here: tb3-002, since"
        page.until(f'{text}.startsWith("{told}") && {text}.endsWith(" min ago).")', "told")
        ready(page, address, 3)  # a page that is opened later
        page.until(f'{text}.startsWith("{told}")', "told again")
        button = "document.getElementById('estop-reset')"
        assert page.evaluate(f"[{button}.hidden, {button}.textContent]") == [False, "Reset tb3-002"]
        swarm.change("tb3-002", State.ESTOPPED, **why)
        page.click("#estop-reset")
        wait_until(lambda: swarm.states["tb3-002"] is State.IDLE, "reset")
        swarm.changes.clear()
        swarm.change("tb3-002", State.IDLE)
        page.until(f"{ESTOP}.hidden", "no banner")
        assert page.errors == []


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_a_needed_reset_is_told_and_moves_no_button(
    page: Page, capsys: pytest.CaptureFixture[str], width: int, height: int
) -> None:
    first = (
        "['reset', 'stop', 'run-open'].sort((one, other) =>"
        " document.getElementById(one).getBoundingClientRect().x"
        " - document.getElementById(other).getBoundingClientRect().x).join()"
    )
    with shown(7, capsys) as (_, (address,)):
        page.resize(width, height, is_phone=width < 900)
        ready(page, address, 7)
        places = box_of(page, "#stop"), box_of(page, "#estop")
        grey = "document.getElementById('reset').getAttribute('aria-disabled')"
        assert page.evaluate(f"[{first}, {grey}]") == ["run-open,stop,reset", "true"]
        page.click("#reset")
        page.until(f"{LINE}.startsWith('reset: not sent')", "nothing to reset")
        page.click("#estop")
        page.until(f"{first} === 'run-open,stop,reset' && {grey} === 'false'", "Reset is usable")
        page.click("#reset")  # asks
        assert (box_of(page, "#stop"), box_of(page, "#estop")) == places
        page.click("#reset")
        page.until(f"{first} === 'run-open,stop,reset' && {grey} === 'true'", "Reset is grey")


ARENA = (
    "(() => { const { model, map } = swarm; model.arena = {size: [%f, %f], shapes: [], poles: []};"
    " for (const one of model.robots.values()) one.x = one.y = 0; map.isTouched = false; map.fit();"
    " const [w, h] = model.arena.size;"
    " return map.scale * Math.min(w, h) / Math.min(map.canvas.clientWidth, map.canvas.clientHeight)"
    "; })()"
)
"""The share of the shorter side of the map's pane that an arena fills, with its robots inside."""


@pytest.mark.parametrize(("width", "height"), WIDTHS[1:])
@pytest.mark.parametrize("size", [(6.3, 6.3), (6.0, 4.0)])
def test_the_arena_fills_the_pane(
    page: Page,
    capsys: pytest.CaptureFixture[str],
    width: int,
    height: int,
    size: tuple[float, float],
) -> None:
    with shown(7, capsys) as (_, (address,)):
        page.resize(width, height)
        ready(page, address, 7)
        page.until("document.getElementById('caveat').checkVisibility()", "a hint")
        page.until("swarm.map.insets[2] > document.getElementById('hints').offsetWidth", "measured")
        assert page.evaluate(ARENA % size) >= 0.9
        # Tools and hints are beside the arena.
        left = page.evaluate(f"swarm.map.toScreen(-{size[0] / 2}, 0)[0] / swarm.map.ratio")
        for name in ("#tools", "#hints"):
            x, _, wide, _ = box_of(page, name)
            assert x + wide <= left


def test_the_card_is_below_the_table_of_a_wide_window(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(7, capsys) as (_, (address,)):
        page.resize(1280, 720)
        ready(page, address, 7)
        page.click("#robots-open")
        page.evaluate("swarm.model.select(['tb3-003'])")
        page.until("document.getElementById('detail-pane').offsetHeight > 40", "a card")
        page.click("#detail-more summary")
        page.until("document.getElementById('detail-values').offsetHeight > 100", "details")
        (x, y, wide, high), table = box_of(page, "#detail-pane"), box_of(page, "#list-pane")
        assert [x, wide] == pytest.approx([table[0], table[2]], abs=1.0)
        assert y == pytest.approx(table[1] + table[3], abs=1.0)
        assert table[3] >= 100
        map_pane = box_of(page, "#map-pane")
        assert map_pane[0] + map_pane[2] <= x + 1.0
        assert y + high == pytest.approx(map_pane[1] + map_pane[3], abs=1.0)


@pytest.mark.parametrize(("width", "height", "least"), [(320, 640, 120), (390, 844, 200)])
def test_a_phone_shows_the_map_beside_a_card_and_reaches_its_details(
    page: Page, capsys: pytest.CaptureFixture[str], width: int, height: int, least: int
) -> None:
    with shown(7, capsys) as (swarm, (address,)):
        page.resize(width, height, is_phone=True)
        swarm.change("tb3-005", State.ESTOPPED)
        ready(page, address, 7)
        page.evaluate("swarm.model.select(['tb3-003'])")
        page.until("document.getElementById('detail-pane').offsetHeight > 40", "a card")
        free = box_of(page, "#detail-pane")[1] - box_of(page, "#map-pane")[1]
        assert free >= 0.3 * height
        page.click("#detail-more summary")
        page.until("document.getElementById('detail-values').offsetHeight > 100", "details")
        shown_part = (
            "(() => { const pane = document.getElementById('detail-pane').getBoundingClientRect();"
            " const one = document.getElementById('detail-more').getBoundingClientRect();"
            " const top = Math.max(one.top, pane.top + 44);"
            " return Math.min(one.bottom, pane.bottom) - top; })()"
        )
        page.until(f"{shown_part} >= {least}", "details in view")
        assert page.evaluate(TARGETS) == []
        x, y, width, high = box_of(page, "#detail-pane")
        place = f"{x + width / 2}, {y + high - 20}"
        assert page.evaluate(f"!!document.elementFromPoint({place})?.closest('#detail-more')")


def test_a_touch_opens_a_cut_note(page: Page, capsys: pytest.CaptureFixture[str]) -> None:
    with shown(3, capsys) as (_, (address,)):
        page.resize(320, 640, is_phone=True)
        ready(page, address, 3)
        note = "document.getElementById('caveat')"
        page.until(f"{note}.checkVisibility() && {note}.scrollWidth > {note}.clientWidth", "cut")
        page.click("#caveat")
        assert page.evaluate(f"{note}.scrollWidth <= {note}.clientWidth")
        page.click("#caveat")
        assert page.evaluate(f"{note}.scrollWidth > {note}.clientWidth")


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_titles_are_above_their_columns(
    page: Page, capsys: pytest.CaptureFixture[str], width: int, height: int
) -> None:
    with shown(7, capsys, ["tb3-003"]) as (_, (address,)):
        page.resize(width, height, is_phone=width < 900)
        ready(page, address, 7)
        page.click("#robots-open")
        page.until("document.querySelectorAll('tr[data-name]').length > 3", "rows")
        apart = page.evaluate(
            "['name', 'state', 'battery', 'age'].flatMap((key) => {"
            " const [th, td] = ['th', 'tr[data-name] td'].map((one) =>"
            " document.querySelector(`${one}.${key}`).getBoundingClientRect());"
            " return [th.left - td.left, th.right - td.right]; })"
        )
        assert apart == pytest.approx([0.0] * 8, abs=1.0)
        assert page.evaluate("document.documentElement.scrollWidth") == width


@pytest.mark.parametrize("width", [390, 1280])
def test_a_lane_has_40_px_and_tells_its_least_its_most_and_the_unit(
    page: Page, capsys: pytest.CaptureFixture[str], width: int
) -> None:
    with shown(2, capsys) as (_, (address,)):
        page.resize(width, 800, is_phone=width < 900)
        ready(page, address, 2)
        page.evaluate("swarm.panels.open('time', true)")
        drawn = page.evaluate(
            "(() => { const { plots, model } = swarm, fill = plots.ctx.fillText, texts = [];"
            " model.plot({ first: 0, times: [100, 101, 102], values:"
            " { clusters: [4, 3, 2], speed: [0.1, 0.3, 0.2], active: [0.5, 0.5, 0.5] } });"
            " plots.ctx.fillText = function (text, x, y) { texts.push(String(text));"
            " fill.call(this, text, x, y); };"
            " plots.draw(); delete plots.ctx.fillText;"
            " const axis = 1.1 * parseFloat(getComputedStyle(document.documentElement).fontSize);"
            " return [texts, plots.canvas.clientHeight - axis]; })()"
        )
        texts, high = drawn
        assert high == pytest.approx(3 * 40, abs=1.0)
        unit = "" if width < 900 else " m/s"
        for text in ("4", "2", "0.3" + unit, "0", "0.2 m/s", "50 %"):
            assert text in texts
        assert "100" + (" %" if unit else "") in texts


def test_the_line_of_a_pattern_is_whole_and_clear_of_the_map(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(2, capsys, describe=described) as (_, (address,)):
        page.resize(1280, 720)
        ready(page, address, 2)
        page.click("#run-open")
        line = "document.querySelector('#pattern-list [data-name=attraction] span')"
        page.until(f"{line}.textContent.length > 100", "a long line")
        assert page.evaluate(f"{line}.scrollWidth <= {line}.clientWidth")
        assert page.evaluate(f"getComputedStyle({line}).whiteSpace") == "normal"


def test_a_robot_has_a_bar_ahead_and_a_wheel_on_each_side(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    seen = (
        "((yaw, platform) => { const { map, model } = swarm; model.robots.clear();"
        " model.byIndex = []; model.add({ name: 'one', index: 0, platform,"
        " footprint: [[-0.2, -0.15], [0.2, -0.15], [0.2, 0.15], [-0.2, 0.15]] }, undefined, {});"
        " const robot = model.robots.get('one'); Object.assign(robot, { x: 0, y: 0, yaw,"
        " heard: performance.now(), age: 0 }); Object.assign(robot.row, { presence: 'alive',"
        " state: 'running', stands: '' }); map.isTouched = true; map.hasFitted = true;"
        " map.shows.names = false; map.centre = [0, 0]; map.scale = 200; map.draw();"
        " return [[0.136, 0], [0, 0.15], [0, -0.15], [-0.1, 0]].map(([u, v]) => {"
        " const c = Math.cos(yaw), s = Math.sin(yaw);"
        " const [x, y] = map.toScreen(c * u - s * v, s * u + c * v);"
        " const [r, g, b] = map.ctx.getImageData(Math.round(x), Math.round(y), 1, 1).data;"
        " return r > 200 && g > 200 && b > 200 ? 'light' : r < 80 && g < 80 ? 'dark' : 'body';"
        " }); })"
    )
    with shown(1, capsys) as (_, (address,)):
        ready(page, address, 1)
        for yaw in (0.0, 2.0):
            found = page.evaluate(f"{seen}({yaw}, 'burger')")
            assert found == ["light", "dark", "dark", "body"]
        assert page.evaluate(f"{seen}(0, 'crazyflie')")[1:3] != ["dark", "dark"]


STICK = "document.getElementById('stick')"


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1280, 720)])
def test_a_stick_drives_the_selected_robot_until_it_is_released_or_lost(
    page: Page,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    width: int,
    height: int,
) -> None:
    hands: list[FakeHand] = []

    def take(commander: LiveCommander, robot: str) -> FakeHand:
        assert robot == "tb3-001"
        hands.append(FakeHand())
        return hands[-1]

    monkeypatch.setattr(LiveCommander, "take", take)
    with shown(2, capsys) as (_, (address,)):
        page.resize(width, height, is_phone=width < 900)
        ready(page, address, 2)
        page.evaluate("swarm.model.select(['tb3-001'])")
        for end in ("#release", ""):
            hold(page)
            x, y, size, _ = box_of(page, "#stick")
            middle = x + size / 2.0, y + size / 2.0
            assert size >= 44
            assert 0.0 <= x <= width - size
            assert y + size <= height
            assert page.evaluate("document.getElementById('slide').hidden")  # its base cannot
            point(page, "mousePressed", *middle)
            point(page, "mouseMoved", middle[0], y + 4.0)
            wait_until(lambda: any(ahead > 0.1 for ahead, _, _ in hands[-1].moves), "it drives")
            point(page, "mouseReleased", middle[0], y + 4.0)
            wait_until(lambda: hands[-1].moves[-1][:2] == (0.0, 0.0), "it stands")
            assert not hands[-1].ends
            if end:
                page.click(end)
            else:
                page.evaluate(f"{STICK}.dispatchEvent(new PointerEvent('pointercancel'))")
            wanted = "released" if end else "closed"
            wait_until(lambda: bool(hands[-1].ends), "the end")
            assert hands[-1].ends[0] == wanted
            page.until("document.getElementById('hand').hidden", "no stick")
        assert page.errors == []


def hold(page: Page) -> None:
    """Press the button that takes the robot: again while it moves, or the machine is too late."""

    def is_held() -> bool:
        if page.evaluate("!document.getElementById('drive').hidden"):
            page.click("#drive")
        return bool(page.evaluate("!document.getElementById('hand').hidden"))

    wait_until(is_held, "a hand")


def point(page: Page, kind: str, x: float, y: float) -> None:
    """The mouse is pressed, moved or released at a place."""
    page.call(
        "Input.dispatchMouseEvent",
        type=kind,
        x=x,
        y=y,
        button="left",
        clickCount=1,
        buttons=0 if kind == "mouseReleased" else 1,
    )
