"""What `swarmd --check` says of protection, for each mode."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

import pytest

from swarmd.cli.preflight import check_daemon, command_timeout_text, protection_text
from swarmd.core.values import Value
from swarmd.daemon.driver_factory import make_driver
from swarmd.driver_api.driver import Finding
from swarmd.protection.settings import Mode
from swarmd.settings.platforms import load_platform
from swarmd.settings.settings import DaemonSettings, load_daemon_settings


def told(platform: str, mode: str) -> Mapping[str, Any]:
    return {**load_platform(platform).protection, "mode": mode}


@pytest.mark.parametrize("mode", get_args(Mode))
def test_the_mode_in_force_comes_first(mode: str) -> None:
    assert protection_text(told("jackal", mode)).startswith(mode)


def test_the_main_numbers_of_each_mode_are_said() -> None:
    barrier = load_platform("jackal").protection["barrier"]
    text = protection_text(told("jackal", "barrier"))
    for name in ("others_speed", "unseen_extent", "margin", "braking_linear", "keep_out"):
        assert f" {barrier[name]:g} m" in text, name
    assert "of the sensor" in text
    assert "of the sensor" not in protection_text(told("burger", "barrier"))
    assert protection_text(told("burger", "potential_field")) == (
        "potential_field (paper) within 0.5 m"
    )
    assert protection_text(told("burger", "stop_zone")) == (
        "stop_zone: stops within 0.1 m, 30% of the wish within 0.25 m"
    )
    assert protection_text(told("burger", "off")) == "off: nothing keeps it from touching anything"


def driven(folder: Path, **options: Value) -> DaemonSettings:
    values = {"id": "r", "state_dir": str(folder), "driver_options": options}
    return load_daemon_settings(None, values)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "the base stops by itself when commands end"),
        ({"command_timeout": 0.25}, "the base stops by itself after 0.25 s when commands end"),
        (
            {"command_timeout": 0.5, "idle_output": "silent"},
            "the base stops by itself after 0.5 s when commands end; while idle it is left to"
            " others",
        ),
        (
            {"command_timeout": "none"},
            "the base never stops by itself (so its platform says); a stopper says zero for a lost"
            " daemon",
        ),
    ],
)
def test_how_the_base_stops_is_said(
    tmp_path: Path, options: Mapping[str, Value], text: str
) -> None:
    settings = driven(tmp_path, **options)
    assert command_timeout_text(settings, make_driver(settings)) == text


def test_a_base_whose_driver_is_its_own_stopper_is_said_to_have_none(tmp_path: Path) -> None:
    values = {"id": "r", "state_dir": str(tmp_path), "platform": "burger", "driver": "ros1"}
    settings = load_daemon_settings(None, values)
    assert command_timeout_text(settings, make_driver(settings)) == (
        "the base never stops by itself (so its platform says); a process of its driver says zero"
        " for a lost daemon"
    )


def test_the_driver_has_what_is_left_of_five_seconds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given: list[float] = []

    class Prompt:
        is_simulated = True

        async def check(self, seconds: float) -> tuple[Finding, ...]:
            given.append(seconds)
            return (Finding("scan", True, "5.0 Hz"),)

    monkeypatch.setattr("swarmd.cli.preflight.make_driver", lambda settings: Prompt())
    assert check_daemon(driven(tmp_path)) == 0
    assert 3.0 <= given[0] < 5.0
    assert "scan 5.0 Hz" in " ".join(capsys.readouterr().out.split())


def test_a_driver_that_cannot_be_made_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert check_daemon(driven(tmp_path, command_timeout="never")) == 1
    assert "FAIL driver simulated driver simulated: deadman is 'never'; wanted" in " ".join(
        capsys.readouterr().out.split()
    )
