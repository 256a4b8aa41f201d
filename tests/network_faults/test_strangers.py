"""Ten Zenoh programs with their default configuration, which dial each robot that they find."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.field import Field
from tests.support.field_swarm import FieldSwarm, Lines
from tests.support.network_matrix import FAR, NEAR
from tests.support.processes import wait_until

pytestmark = pytest.mark.integration

COUNT = 10
STRANGERS = "tests.support.zenoh_strangers"
STRANGER = (sys.executable, "-m", STRANGERS, "1")


@pytest.mark.parametrize(
    ("robots", "is_secured", "discoverable"),
    [
        pytest.param(("r1", "r2", "r3", "r4"), False, None, id="insecure"),
        pytest.param(("r1", "r2"), True, True, id="secured"),
        pytest.param(("r1", "r2"), True, None, id="secured, by default"),
    ],
)
def test_strangers_are_no_flood(
    namespaces_permitted: None,
    tmp_path: Path,
    robots: tuple[str, ...],
    is_secured: bool,
    discoverable: bool | None,
) -> None:
    with contextlib.ExitStack() as left:
        field = left.enter_context(contextlib.closing(Field((*robots, FAR, NEAR))))
        network: dict[str, object] = {"discoverable": discoverable}
        swarm = left.enter_context(
            FieldSwarm(tmp_path, field, robots, network=network, is_secured=is_secured)
        )
        swarm.start()
        strangers = swarm.talk(NEAR, STRANGERS, str(COUNT))
        answered = {field.address(robot) for robot in robots}
        if is_secured and not discoverable:
            answered = set()
        listed = [] if is_secured else sorted(robots)

        def have_tried() -> bool:
            seen = strangers.ask(swarm.name)
            heard = {one.partition("/")[2].rpartition(":")[0] for one in seen["locators"]}
            assert not (is_secured and any(seen["tokens"]))
            assert answered or not heard & {field.address(robot) for robot in robots}
            return heard >= answered and seen["tokens"] == [listed] * COUNT

        wait_until(have_tried, "the strangers find the robots, and list those that let them")
        if is_secured and discoverable:
            sent = 0

            def have_dialled() -> bool:
                nonlocal sent
                sent += field.traffic()[NEAR].unicast_frames
                return sent >= COUNT * len(robots)

            wait_until(have_dialled, "the robots have refused each stranger")
        done = swarm.ctl(FAR, "estop", "-o", "json")
        assert (done.code, done.json["missing"]) == (0, []), done
        members = dict[str, Any]()

        def are_alive() -> bool:
            members.update(swarm.members(FAR))
            return {*members} == {*robots} and all(
                one["presence"] == "alive" and one["status"] for one in members.values()
            )

        wait_until(are_alive, "all robots are heard, and answer")
        for robot in robots:
            dropped = members[robot]["status"]["health"]["dropped"]
            assert not [kind for kind in dropped if kind.startswith(("flood", "message"))], dropped
            assert swarm.is_alive(robot)
            assert "connections wait" not in swarm.daemons[robot].text()
        assert have_tried()
        if is_secured:
            words = ("--dial",) if discoverable else ()  # else it dials without being asked to
            dialled = swarm.ctl(FAR, "zenoh", *words, "-o", "json")
            assert len(dialled.json["config"]["connect"]["endpoints"]) == len(robots), dialled


def test_a_robot_answers_scouts_once_it_has_an_ipv4_address(
    namespaces_permitted: None, tmp_path: Path
) -> None:
    """Also again, after it had none for a while: Zenoh's scouts are of IPv4 alone."""
    with contextlib.ExitStack() as left:
        field = left.enter_context(contextlib.closing(Field(("r1", NEAR))))
        swarm = left.enter_context(FieldSwarm(tmp_path, field, ("r1",)))
        address = f"{field.address('r1')}/24 dev eth0"
        field.ip("r1", f"addr del {address}")
        swarm.start()

        def change(wanted: str, *lines: str) -> None:
            """Change the addresses, and wait until the daemon has told so."""
            field.ip("r1", *lines)
            text = swarm.daemons["r1"].text
            wait_until(lambda: wanted in text().rpartition("eth0: ")[2], f"r1 tells {wanted}")

        def check_found() -> None:
            with contextlib.closing(Lines((*field.prefix(NEAR), *STRANGER))) as stranger:
                wait_until(lambda: stranger.ask(swarm.name)["tokens"] == [["r1"]], "r1 is found")

        text = swarm.daemons["r1"].text
        # At first it may have no address at all: its link-local one is being probed.
        wait_until(lambda: "no IPv4 address yet" in text(), "r1 tells that it has none")
        change("up, 10.80", f"addr add {address}")
        check_found()
        change("no IPv4 address yet", f"addr del {address}")
        change("up, 10.80", f"addr add {address}")
        check_found()
        change("no address yet", "addr flush dev eth0")
        change("-> 10.80.0.77", "addr add 10.80.0.77/24 dev eth0")
        check_found()
        assert swarm.is_alive("r1")
