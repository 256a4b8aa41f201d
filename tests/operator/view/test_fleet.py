"""The page in a real browser with many robots, whose messages are fed to the server."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Any, cast

import pytest

from swarmd.core.messages import State
from swarmd.operator.cli.web import Served, WebOptions
from swarmd.operator.session.operator import Operator
from swarmd.operator.view.commander import LiveCommander
from swarmd.operator.view.live import Describe, LiveSource
from tests.support.chromium import FOUND, Page
from tests.support.fed_swarm import PATTERNS, FedOperator, FedSwarm
from tests.support.processes import wait_until

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(FOUND is None, reason="no Chromium here"),
]

LAST = "document.querySelector('.answer[data-final=\"true\"]')"
ANSWER = "document.querySelector('.answer[data-final=\"true\"]').textContent"
ESTOP = "document.getElementById('estop-state')"


@contextmanager
def shown(
    count: int,
    capsys: pytest.CaptureFixture[str],
    silent: Collection[str] = (),
    tokens: tuple[str, str] = ("", ""),
    describe: Describe | None = None,
    patterns: Sequence[str] = PATTERNS,
) -> Iterator[tuple[FedSwarm, list[str]]]:
    """A fed swarm and the addresses of its page."""
    with FedSwarm(count, silent) as swarm:
        make = cast("Callable[[], Operator]", lambda: FedOperator(swarm))
        source = LiveSource(make(), patterns, describe)
        commander = LiveCommander(make, source.expected)
        source.start()
        try:
            with closing(Served(source, commander, WebOptions("127.0.0.1", 0, *tokens))):
                lines = capsys.readouterr().err.splitlines()
                yield swarm, [line.partition(": ")[2] for line in lines]
        finally:
            commander.close()
            source.close()


def ready(page: Page, address: str, count: int) -> None:
    """Open a page, and wait until it knows the state and place of each robot."""
    page.open(address)
    known = "[...swarm.model.robots.values()].filter((one) => one.row.state && one.x === one.x)"
    page.until(f"{known}.length === {count}", f"{count} robots")


def rows(page: Page) -> Any:
    return page.evaluate(
        "[...document.querySelectorAll('tr[data-name]')].map((r) => r.dataset.name)"
    )


def test_commands_to_500_robots_are_counted(page: Page, capsys: pytest.CaptureFixture[str]) -> None:
    with shown(500, capsys) as (swarm, (address,)):
        ready(page, address, 500)
        page.click("#robots-open")
        page.until("document.querySelectorAll('tr[data-name]').length > 5", "the table")
        assert len(rows(page)) < 60  # only what is seen
        page.click("#run-open")
        page.type("#pattern", "drive")

        def are_counted() -> bool:
            """On a busy machine some of 500 answers come too late: asked again."""
            before = page.evaluate(f"{LAST} ? {LAST}.id : ''")
            page.click("#run")
            page.until(f"{LAST} && {LAST}.id !== '{before}'", "an answer, also that it is too late")
            counts = f"{ANSWER}.startsWith('run: 500 targeted, 499 applied, 1 refused')"
            return bool(page.evaluate(counts))

        wait_until(are_counted, "counted")
        first = "document.querySelector('.answer li').textContent"
        assert page.evaluate(first) == "1 refused: busy (tb3-500)"
        page.click("#estop")
        page.until(f"{ESTOP}.className === 'good' || {ESTOP}.className === 'bad'", "acknowledged")
        assert set(swarm.states.values()) == {State.ESTOPPED}

        def is_confirmed() -> bool:
            """A first click waits for a second, for a few seconds alone."""
            page.click("#reset")
            return not page.evaluate("document.querySelector('#reset').matches('.armed')")

        wait_until(is_confirmed, "confirmed")
        page.until(f"{ANSWER}.startsWith('reset: 500 targeted')", "reset")
        assert page.errors == []


def test_an_estop_is_shown_on_all_pages_until_all_have_acknowledged(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    tokens = ("operator-token", "viewer-token")
    with shown(7, capsys, ["tb3-003"], tokens) as (swarm, (whole, read_only)):
        ready(page, whole, 7)
        page.click("#estop")
        missing = f"{ESTOP}.textContent.includes('tb3-003') && !{ESTOP}.hidden"
        page.until(missing, "the robot that lacks an acknowledgement")
        page.open(whole.partition("?")[0])  # the tab keeps its token
        page.until(missing, "the same after a reload")
        page.open(read_only)
        page.until(missing, "the same on a page that only looks")
        assert page.evaluate("document.getElementById('estop-end').hidden") is True
        swarm.silent.clear()
        page.until(f"{ESTOP}.className === 'good'", "all have acknowledged")
        ready(page, read_only, 7)  # opened later
        page.evaluate("swarm.model.select(['tb3-001'])")
        card = "document.getElementById('detail-why').textContent"
        page.until(
            f"{card}.includes('by anna, 5 min ago, for swarm from the page; clear')",
            "who, when and why",
        )


def test_an_estop_can_be_ended_and_begun_again(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys, ["tb3-003"]) as (_, (address,)):
        ready(page, address, 3)
        for _ in range(2):
            page.evaluate("document.activeElement.blur()")
            page.evaluate("swarm.actions.hideEstop()")
            page.call("Input.dispatchKeyEvent", type="keyDown", key="Escape", modifiers=8)
            page.until(f"!{ESTOP}.hidden && {ESTOP}.textContent.includes('tb3-003')", "waits")
        page.click("#estop-end")
        page.until(f"{ANSWER}.includes('no answer (tb3-003)')", "it names the robot")


def test_an_estop_whose_link_was_lost_claims_no_acknowledgement(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys, ["tb3-003"]) as (_, (address,)):
        ready(page, address, 3)
        # Before the server told which robots lack an acknowledgement.
        page.evaluate("swarm.actions.send = () => true; swarm.actions.estop()")
        page.evaluate("swarm.actions.lost(false)")
        assert "acknowledged it is not known" in page.evaluate(f"{ESTOP}.textContent")
        page.evaluate("swarm.model.tell('hello')")
        assert "repeats no emergency stop" in page.evaluate(f"{ESTOP}.textContent")
        assert page.evaluate("document.getElementById('estop-end').textContent") == "Close"
        page.click("#estop-end")
        assert page.evaluate(f"{ESTOP}.hidden") is True


def test_a_robot_far_away_costs_no_more_than_another(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (_, (address,)):
        ready(page, address, 3)
        lines = page.evaluate(
            "(() => { const { map, model } = swarm; let lines = 0;"
            " map.ctx.lineTo = () => { lines += 1; };"
            " for (const x of [1e9, 1e30]) {"
            " [...model.robots.values()][0].x = x; map.fit(); map.draw();"
            " model.select(['tb3-001']); map.isFollowing = true; map.scale = 1000; map.draw(); }"
            " return lines; })()"
        )
        assert 0 < lines < 5000


def test_a_command_of_an_old_picture_starts_nothing(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(2, capsys) as (swarm, (address,)):
        ready(page, address, 2)
        page.click("#stop")
        wait_until(lambda: set(swarm.states.values()) == {State.STOPPED}, "both stopped")
        page.evaluate("swarm.actions.act('run', {seen: 0, targets: ['tb3-001'], pattern: 'drive'})")
        page.until(f"{ANSWER}.includes('came too late')", "refused")
        assert set(swarm.states.values()) == {State.STOPPED}


def test_list_and_map_share_one_selection(page: Page, capsys: pytest.CaptureFixture[str]) -> None:
    with shown(7, capsys, ["tb3-005"]) as (_, (address,)):
        ready(page, address, 7)
        page.click("#robots-open")
        page.until("document.querySelectorAll('tr.stale').length === 1", "one is silent")
        page.type("#filter", "silent")
        page.until("document.querySelectorAll('tr[data-name]').length === 1", "filtered")
        page.click("tr[data-name='tb3-005'] td")
        assert page.evaluate("[...swarm.model.selected]") == ["tb3-005"]
        page.evaluate(
            "const f = document.getElementById('filter'); f.value = '';"
            " f.dispatchEvent(new Event('input'))"
        )
        page.click("th[data-key='name']")
        page.click("th[data-key='name']")
        page.until("document.querySelector('tr[data-name]').dataset.name === 'tb3-007'", "sorted")
        x, y = place(page, "tb3-001")  # at the left: the card is at the right
        page.mouse(x, y)
        page.until("swarm.model.selected.has('tb3-001')", "selected on the map")
        page.until(
            "document.querySelector(\"tr[data-name='tb3-001']\").ariaSelected === 'true'",
            "selected in the list",
        )
        page.until("document.querySelectorAll('#detail-values dt').length > 10", "details")
        page.until("document.getElementById('dial-text').textContent.includes('Requested')", "dial")


def test_odometry_is_aligned_by_drag_and_kept(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(2, capsys) as (_, (address,)):
        ready(page, address, 2)
        page.click("#stop")
        page.until("[...swarm.model.robots.values()].every((r) => r.row.state === 'stopped')", "-")
        before = page.evaluate("[swarm.model.robots.get('tb3-001').x, swarm.map.scale]")
        page.click("#align")
        start = place(page, "tb3-001")
        page.drag(start, (start[0] + 60, start[1]))
        moved = "swarm.model.robots.get('tb3-001').x"
        page.until(f"Math.abs({moved} - {before[0] + 60 / before[1]}) < 0.02", "dragged")
        page.evaluate("swarm.model.select(['tb3-001'])")
        x, y = place(page, "tb3-001")
        page.drag((x + 80, y), (x + 80, y - 80))
        page.until("swarm.model.robots.get('tb3-001').offset[2] > 0.6", "turned")
        ready(page, address, 2)
        assert page.evaluate("swarm.model.robots.get('tb3-001').offset[2]") > 0.6


def test_a_label_selects_its_robots(page: Page, capsys: pytest.CaptureFixture[str]) -> None:
    with shown(4, capsys) as (swarm, (address,)):
        ready(page, address, 4)
        page.until("document.getElementById('label').options.length === 3", "two labels")
        page.evaluate(
            "(() => { const label = document.getElementById('label'); label.value = 'red';"
            " label.dispatchEvent(new Event('change')); })()"
        )
        page.click("#stop")
        page.until(f"{ANSWER}.startsWith('stop: 2 targeted, 2 applied')", "counted")
        stopped = {name for name, state in swarm.states.items() if state is State.STOPPED}
        assert stopped == {"tb3-002", "tb3-004"}


def test_a_phone_shows_the_estop_at_any_place_of_the_page(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    with shown(3, capsys) as (swarm, (address,)):
        page.resize(390, 844, is_phone=True)
        ready(page, address, 3)
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        page.evaluate("scrollTo(0, document.body.scrollHeight)")
        bottom = "document.getElementById('estop').getBoundingClientRect().bottom"
        assert page.evaluate(bottom) == 844
        page.mouse(195, 820)
        wait_until(lambda: set(swarm.states.values()) == {State.ESTOPPED}, "all stopped")


def place(page: Page, name: str) -> tuple[float, float]:
    """Where on the screen the map shows a robot."""
    x, y = page.evaluate(
        f"(() => {{ const r = swarm.model.robots.get('{name}'), m = swarm.map;"
        " const b = m.canvas.getBoundingClientRect(), [x, y] = m.toScreen(r.x, r.y);"
        " return [b.x + x / m.ratio, b.y + y / m.ratio]; })()"
    )
    return x, y
