"""The input of an agent ends with either end of its connection."""

from __future__ import annotations

import asyncio
import os

import pytest

from swarmd.sim.cli.mcp_input import CallInput
from tests.support.processes import CAP


@pytest.mark.parametrize("closed", ["calls", "answers"])
def test_an_agent_that_closes_one_end_ends_the_input(closed: str) -> None:
    calls, call = os.pipe()
    answer, answers = os.pipe()
    lines: list[str] = []

    async def read() -> None:
        async for line in CallInput(calls, answers):
            lines.append(line)
            if len(lines) > 1:
                continue
            os.close(call if closed == "calls" else answer)

    os.write(call, b"{}\n")
    asyncio.run(asyncio.wait_for(read(), CAP))
    assert lines[0] == "{}"
    for file in (calls, answers, answer if closed == "calls" else call):
        os.close(file)
