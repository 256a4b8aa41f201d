"""The figures of a swarm for programs, as a reader of the text exposition format takes them.

The reader is made after the format's page ("Exposition formats", version 0.0.4 of the text format),
and knows nothing of the writer.
"""

from __future__ import annotations

import asyncio
import re
from typing import Any, cast

import pytest
from msgspec.structs import replace

from swarmd.core.messages import Health, LoggedEvent, Presence, ProcessUsage, Reason, State, Status
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.operator import Operator
from swarmd.operator.view.access import Access
from swarmd.operator.view.live import LiveSource
from swarmd.operator.view.metrics import CONTENT_TYPE, LOOK_SILENCE, Seen, exposition
from tests.operator.view.test_server import connected, serving
from tests.support.fed_swarm import PATTERNS, FedOperator, FedSwarm
from tests.support.statuses import make_member, status

Figures = dict[tuple[str, frozenset[tuple[str, str]]], float]

NAME = r"[a-zA-Z_:][a-zA-Z0-9_:]*"
LABEL = re.compile(r'([a-zA-Z_][a-zA-Z0-9_]*)="((?:[^"\\\n]|\\\\|\\"|\\n)*)"(?:,|$)')
SAMPLE = re.compile(rf"({NAME})(?:\{{(.*)\}})? (\S+)(?: -?\d+)?")
TYPES = {"counter", "gauge", "histogram", "summary", "untyped"}
UNESCAPED = {"\\\\": "\\", '\\"': '"', "\\n": "\n"}


def read(text: str) -> tuple[Figures, dict[str, str]]:
    """The figures of a text, and the type of each family; AssertionError for what is no such text.

    All lines of a family stand together, HELP and TYPE before its figures, and no figure twice.
    """
    assert text.endswith("\n")
    figures: Figures = {}
    types: dict[str, str] = {}
    helped: set[str] = set()
    current = ""
    for line in text.splitlines():
        if line.startswith("# HELP "):
            _, _, name, about = line.split(" ", 3)
            assert name not in helped
            assert about
            helped.add(name)
            current = name
            continue
        if line.startswith("# TYPE "):
            _, _, name, kind = line.split(" ")
            assert name == current
            assert kind in TYPES
            assert name not in types
            types[name] = kind
            continue
        found = SAMPLE.fullmatch(line)
        assert found is not None, line
        name, inside, value = found.groups()
        assert name == current
        assert name in types
        labels: dict[str, str] = {}
        at = 0
        while at < len(inside or ""):
            label = LABEL.match(inside, at)
            assert label is not None, line
            assert label[1] not in labels
            labels[label[1]] = re.sub(r"\\.", lambda one: UNESCAPED[one[0]], label[2])
            at = label.end()
        key = name, frozenset(labels.items())
        assert key not in figures
        figures[key] = float(value)
    return figures, types


def value(figures: Figures, name: str, **labels: str) -> float | None:
    """A figure; None where it is left out."""
    return figures.get((name, frozenset(labels.items())))


def seen(*statuses: tuple[Status, float], **changes: Any) -> Seen:
    """A look at r1, which is alive, at r2, which has failed, and at r3, which was never heard."""
    view = MembersView(
        {
            "r1": make_member("r1"),
            "r2": make_member("r2", presence=Presence.FAILED, age=60.0),
        },
        roster=frozenset({"r1", "r2", "r3"}),
    )
    fields: dict[str, Any] = {
        "swarm": "lab",
        "version": "1.2.3",
        "view": view,
        "look_age": 0.5,
        "statuses": {one.robot: (one, age) for one, age in statuses},
    }
    return Seen(**(fields | changes))


def test_the_figures_of_a_robot_that_runs() -> None:
    health = Health(
        scan_rate=5.0,
        loop_p99=0.0041,
        loop_stalls=2,
        host_restarts=1,
        driver_up=True,
        usage=ProcessUsage(cpu=0.25, memory=50_000_000),
    )
    one = status("r1", health=health, readings={"battery": 0.8})
    figures, types = read(exposition(seen((one, 0.5))))
    wanted = {
        "swarmd_robot_up": 1.0,
        "swarmd_robot_status_age_seconds": 0.5,
        "swarmd_robot_uptime_seconds": 100.5,
        "swarmd_robot_held": 0.0,
        "swarmd_robot_estops": 0.0,
        "swarmd_robot_obstacle_meters": 0.61,
        "swarmd_robot_protection_active": 1.0,
        "swarmd_robot_driver_up": 1.0,
        "swarmd_robot_battery_ratio": 0.8,
        "swarmd_robot_scan_rate_hertz": 5.0,
        "swarmd_robot_loop_p99_seconds": 0.0041,
        "swarmd_robot_loop_stalls_total": 2.0,
        "swarmd_robot_host_restarts_total": 1.0,
    }
    assert {name: value(figures, name, robot="r1") for name in wanted} == wanted
    assert value(figures, "swarmd_robot_cpu_ratio", robot="r1", process="daemon") == 0.25
    assert value(figures, "swarmd_robot_memory_bytes", robot="r1", process="daemon") == 5e7
    assert value(figures, "swarmd_robot_cpu_ratio", robot="r1", process="pattern") is None
    states = {one: value(figures, "swarmd_robot_state", robot="r1", state=one) for one in State}
    assert states == {one: float(one == "running") for one in State}
    assert value(figures, "swarmd_robot_pattern_info", robot="r1", pattern="drive") == 1.0
    assert value(figures, "swarmd_info", swarm="lab", version="1.2.3") == 1.0
    assert {name for name, kind in types.items() if kind == "counter"} == {
        name for name in types if name.endswith("_total")
    }


def test_presence_and_holds() -> None:
    held = status("r1", reason=Reason.NO_SCAN)
    figures, _ = read(exposition(seen((held, 0.0))))
    up = {name: value(figures, "swarmd_robot_up", robot=name) for name in ("r1", "r2", "r3")}
    assert up == {"r1": 1.0, "r2": 0.0, "r3": 0.0}
    counts = {
        one: value(figures, "swarmd_robots", presence=one)
        for one in ("alive", "left", "failed", "expected")
    }
    assert counts == {"alive": 1.0, "left": 0.0, "failed": 1.0, "expected": 1.0}
    assert value(figures, "swarmd_robot_presence", robot="r3", presence="expected") == 1.0
    assert value(figures, "swarmd_robot_held", robot="r1") == 1.0
    assert value(figures, "swarmd_robot_reason_info", robot="r1", reason="no_scan") == 1.0


def test_what_is_old_or_unknown_is_left_out_and_its_age_is_told() -> None:
    old = status("r1")
    figures, _ = read(exposition(seen((old, 3.5), look_age=LOOK_SILENCE + 1.0)))
    assert {name for name, _ in figures} == {
        "swarmd_info",
        "swarmd_look_age_seconds",
        "swarmd_robot_status_age_seconds",
    }
    assert value(figures, "swarmd_robot_status_age_seconds", robot="r1") == 3.5

    no_look, _ = read(exposition(seen(look_age=None)))
    assert {name for name, _ in no_look} == {"swarmd_info"}

    decision = replace(old.decision, min_gap=None)
    stale = status("r1", decision=decision, readings={"battery": 0.8}, stale_readings=("battery",))
    figures, _ = read(exposition(seen((stale, 0.0))))
    for name in ("swarmd_robot_obstacle_meters", "swarmd_robot_battery_ratio"):
        assert value(figures, name, robot="r1") is None
    for name in ("swarmd_robot_cpu_ratio", "swarmd_robot_memory_bytes"):
        assert value(figures, name, robot="r1", process="daemon") is None


def test_texts_of_others_stay_in_their_labels() -> None:
    hostile = 'a"} 1\n# TYPE b\\n c'
    figures, _ = read(exposition(seen((status("r1", pattern=hostile), 0.0))))
    assert value(figures, "swarmd_robot_pattern_info", robot="r1", pattern=hostile) == 1.0


def test_an_incident_counts_once_whoever_tells_it() -> None:
    def told(id: str, robot: str, kind: str) -> LoggedEvent:
        return LoggedEvent(at=99.0, text=f"incident {id} of {robot}: {kind}: some words")

    with FedSwarm(1) as swarm:
        source = LiveSource(cast("Operator", FedOperator(swarm)), PATTERNS)
        first = told("0123456789ab", "r2", "hazard")
        source._on_status(status("r1", events=(first,)))
        source._on_status(status("r2", events=(first, told("0123456789ac", "r2", "hazard"))))
        source._on_status(status("r3", events=(told("0123456789ad", "r2", "words of its own"),)))
        figures, _ = read(source.metrics())
    incidents = {labels: count for (name, labels), count in figures.items() if "incidents" in name}
    assert incidents == {frozenset({("robot", "r2"), ("kind", "hazard")}): 2.0}


class MeasuredRobots:
    """A source with figures and nothing else."""

    robots = ()
    playback = None

    def metrics(self) -> str:
        return exposition(seen())


async def get(address: str, path: str = "/metrics", *lines: str) -> tuple[int, str, str]:
    """Code, head and body of an answer."""
    reader, writer = await connected(address)
    host = address.removeprefix("http://").rstrip("/")
    writer.write("\r\n".join((f"GET {path} HTTP/1.1", f"Host: {host}", *lines, "", "")).encode())
    answer = (await reader.read()).decode()
    writer.close()
    head, _, body = answer.partition("\r\n\r\n")
    return int(head.split()[1]), head, body


@pytest.mark.parametrize(
    ("path", "lines", "code"),
    [
        ("/metrics", (), 401),
        ("/metrics?token=wrong", (), 401),
        ("/metrics", ("Authorization: Basic operators",), 401),
        ("/metrics", ("Authorization: Bearer wrong", "Authorization: Bearer operators"), 401),
        ("/metrics", ("Authorization: Bearer operators",), 200),
        ("/metrics", ("Authorization: bearer only-viewers",), 200),
        ("/metrics?token=only-viewers", (), 200),
        ("/metrics", ("Authorization: Bearer operators", "Origin: http://other.example"), 403),
    ],
)
def test_whoever_may_open_a_page_may_read_figures(
    path: str, lines: tuple[str, ...], code: int
) -> None:
    async def ask() -> tuple[int, str, str]:
        access = Access("operators", "only-viewers")
        async with serving(MeasuredRobots(), access=access) as (_, address):
            return await get(address, path, *lines)

    answered, head, body = asyncio.run(ask())
    assert answered == code
    if code == 200:
        assert f"Content-Type: {CONTENT_TYPE}" in head
        assert ("swarmd_info", frozenset({("swarm", "lab"), ("version", "1.2.3")})) in read(body)[0]
    else:
        assert "swarmd_" not in body


def test_a_recorded_run_has_no_figures() -> None:
    async def ask() -> tuple[int, str, str]:
        async with serving() as (_, address):
            return await get(address)

    assert asyncio.run(ask())[0] == 404
