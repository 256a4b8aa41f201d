"""One deadline for a verb: what its look leaves of `--timeout` is for its request."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

import pytest

from swarmd.core.messages import Presence
from swarmd.link.settings import NetworkSettings
from swarmd.operator.cli.options import CommonOptions
from swarmd.operator.cli.swarmctl import cli, exit_code_of, run_cli
from swarmd.operator.session.members_view import Contact, Dials, MembersView, SeenMember
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.session import LEAST_REQUEST_TIME


class Slow:
    """An operator whose look takes `share` of the time that it has."""

    def __init__(self, share: float) -> None:
        self._share = share
        self.settings = NetworkSettings()
        self.waits: list[float] = []
        self.notices: list[str] = []
        self.identity = None
        self.name = "anna"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""

    def members(
        self, *, timeout: float, needs_status: bool, dials: Dials = Dials.ALL
    ) -> MembersView:
        self.waits.append(timeout)
        seen = SeenMember(
            robot="a",
            instance="1",
            presence=Presence.ALIVE,
            age=0.0,
            status=None,
            contact=Contact.NO_ANSWER,
        )
        return MembersView({"a": seen}, seconds=self._share * timeout)

    def trust_notes(self) -> tuple[str, ...]:
        return ()

    def request(self, *_: object, timeout: float, **fields: Any) -> Outcome:
        self.waits.append(timeout)
        return Outcome({}, ("a",))


@pytest.fixture(autouse=True)
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Names for completion go into a folder of the test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.mark.parametrize("verb", [["reset"], ["run", "x"], ["param", "set", "speed=1"]])
@pytest.mark.parametrize(("share", "wait"), [(0.2, 3.6), (1.0, 2.0), (4.0, LEAST_REQUEST_TIME)])
def test_a_look_and_its_request_share_the_timeout(
    monkeypatch: pytest.MonkeyPatch, verb: list[str], share: float, wait: float
) -> None:
    operator = Slow(share)
    monkeypatch.setattr(CommonOptions, "operator", lambda options, **_: operator)
    run_cli(cli, [*verb, "--all", "--timeout", "4s"], "swarmctl", exit_code_of)
    assert operator.waits == pytest.approx([2.0, wait])


def test_a_look_alone_has_the_whole_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    operator = Slow(1.0)
    monkeypatch.setattr(CommonOptions, "operator", lambda options, **_: operator)
    run_cli(cli, ["members", "--timeout", "4s"], "swarmctl", exit_code_of)
    assert operator.waits == [4.0]
