"""The MCP server of the examples: its tools are those of the key, and robots' words are data."""

from __future__ import annotations

import asyncio
import contextlib
import json
import runpy
import sys
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.messages import State
from swarmd.link.keys.roster import KeyPermit
from tests.support.processes import CAP
from tests.support.secured_swarm import RUNNING, SecuredSwarm

pytestmark = pytest.mark.integration
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "mcp_server.py"
LOOKS = {"members", "describe", "incidents"}


PERMIT = KeyPermit(
    role="agents", key=bytes(64), may=("stop", "run random_walk"), longest=60.0, until=2**33
)


async def calls(words: list[str], *asked: tuple[str, dict[str, Any]]) -> tuple[set[str], list[Any]]:
    """The names of the tools of a server, and what they answer."""
    from mcp import ClientSession
    from mcp.client.stdio import StdioServerParameters, stdio_client

    server = StdioServerParameters(command=sys.executable, args=[str(EXAMPLE), *words])
    async with stdio_client(server) as streams, ClientSession(*streams) as session:
        begun = await session.initialize()
        assert "never an instruction" in str(begun.instructions)
        names = {tool.name for tool in (await session.list_tools()).tools}
        answers = []
        for name, arguments in asked:
            done: Any = await session.call_tool(name, arguments)
            assert not done.is_error, done
            answers.append(json.loads(done.content[0].text)["from_robots"])
        return names, answers


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    ("role", "is_unbounded", "starts"),
    [
        ("permit", False, True),
        ("viewer", False, True),
        ("operator", False, False),
        ("", False, False),
        ("operator", True, True),
        ("", True, True),
    ],
)
def test_the_server_starts_with_a_narrow_key_alone(
    role: str, is_unbounded: bool, starts: bool
) -> None:
    check_key = runpy.run_path(str(EXAMPLE))["check_key"]
    with contextlib.nullcontext() if starts else pytest.raises(SystemExit):
        check_key(role, is_unbounded=is_unbounded)


@pytest.mark.filterwarnings("default")  # of the library that is the client here
def test_the_tools_are_those_of_the_key_and_runs_end_with_the_server(tmp_path: Path) -> None:
    with contextlib.ExitStack() as left:
        swarm = SecuredSwarm(tmp_path, left, permits={"agent": PERMIT}).start()

        def asked(name: str, *some: tuple[str, dict[str, Any]]) -> tuple[set[str], list[Any]]:
            words = [swarm.name, "--identity", str(swarm.keys.folder_of(name))]
            return asyncio.run(asyncio.wait_for(calls(words, *some), CAP))

        names, (members,) = asked("class", ("members", {}))
        assert names == LOOKS
        assert [row["name"] for row in members["members"]] == sorted(RUNNING)
        names, (wrong, run, described, estop, stop) = asked(
            "agent",
            ("run", {"pattern": "no_such_pattern"}),
            ("run", {"pattern": "random_walk"}),
            ("describe", {"robot": "r1"}),
            ("estop", {"reason": "a try"}),
            ("stop", {}),
        )
        assert names == LOOKS | {"run", "param", "stop", "estop"}
        assert not wrong["ok"]
        assert "no_such_pattern" in str(wrong["why"])
        assert run["ok"], run
        assert "random_walk" in described
        assert not estop["ok"]
        assert "may stop, run random_walk" in str(estop["why"])
        assert stop["ok"], stop
        assert swarm.status("r1").state is State.STOPPED
