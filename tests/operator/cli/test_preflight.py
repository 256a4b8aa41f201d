"""The findings of `swarmd --check`."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.finding import Finding, Level
from swarmd.core.values import Value
from swarmd.daemon.driver import make_driver
from swarmd.link.keys.roster import KeyPermit, Role, Roster
from swarmd.operator.cli import preflight
from swarmd.operator.cli.effective_config import effective_config
from swarmd.operator.cli.preflight import (
    _check_commands,
    _check_network,
    _platform_text,
    check_daemon,
    check_patterns,
    command_timeout_text,
    peers_text,
    protection_text,
)
from swarmd.settings.platforms import load_platform
from swarmd.settings.settings import DaemonSettings, load_daemon_settings

pytestmark = pytest.mark.usefixtures("forked_starts")

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def protection(platform: str, mode: str) -> Mapping[str, Any]:
    return {**load_platform(platform).protection, "mode": mode}


def settings_of(folder: Path, text: str = "", **values: Any) -> DaemonSettings:
    """Settings from the text of a file, with values above it."""
    (folder / "r.yaml").write_text(text)
    return load_daemon_settings(
        folder / "r.yaml" if text else None, {"id": "r1", "state_dir": str(folder), **values}
    )


def faults(findings: Iterable[Finding]) -> list[str]:
    return [f"{one.subject}: {one.text}" for one in findings if not one.is_well]


@pytest.fixture
def open_firewall(monkeypatch: pytest.MonkeyPatch) -> None:
    """No `nft` is started, as for a user other than root."""
    facts = "swarmd.link.carriers.network_facts._firewall"
    monkeypatch.setattr(facts, lambda: ("open", ""))


def test_a_warning_and_what_was_not_measured_are_told_and_are_no_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = [
        Finding("scan", True, "10 Hz"),
        Finding("scan delay", True, "not measured: no scan", is_measured=False),
        Finding("clock", False, "not synchronised", "start chrony", is_minor=True),
    ]
    monkeypatch.setattr(preflight, "findings_of", lambda settings: found)
    assert check_daemon(settings_of(tmp_path)) == 0
    _, *lines, last = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines] == [
        ["warning", "clock"],
        ["unknown", "scan"],
        ["ok", "scan"],
    ]
    assert lines[0].endswith("not synchronised; start chrony")
    assert last == "3 checked: 0 faults, 1 warning, 1 not known"
    found.append(Finding("cmd_vel", False, "no subscriber", "start the base"))
    assert check_daemon(settings_of(tmp_path)) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split()[:2] == ["fault", "cmd_vel"]  # faults first


@pytest.mark.usefixtures("open_firewall")
def test_a_check_has_the_rows_of_the_doctor_on_this_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """docs/installation.md: `--check` finds what would lose a latch before the daemon starts."""
    for name in ("check_patterns", "_check_driver"):
        monkeypatch.setattr(preflight, name, lambda *_: ())
    found = {one.subject: one for one in preflight.findings_of(settings_of(tmp_path))}
    assert {"clock", "load", "memory", "state", "interface", "ports", "firewall"} <= found.keys()
    assert found["state"].is_well
    (tmp_path / "file").touch()
    lost = settings_of(tmp_path, state_dir=str(tmp_path / "file" / "state"))
    found = {one.subject: one for one in preflight.findings_of(lost)}
    assert found["state"].level is Level.FAULT
    assert {path.name for path in tmp_path.iterdir()} == {"file", "r.yaml"}


@pytest.mark.parametrize(
    ("mode", "numbers"),
    [
        ("barrier", ["m/s2"]),
        ("potential_field", ["0.5 m"]),
        ("stop_zone", ["0.1 m", "30%", "0.25 m"]),
        ("off", ["nothing"]),
    ],
)
def test_the_mode_of_protection_comes_first_then_its_numbers(mode: str, numbers: list[str]) -> None:
    text = protection_text(protection("burger", mode))
    assert text.startswith(mode)
    assert all(number in text for number in numbers)


def test_the_main_numbers_of_the_barrier_are_given() -> None:
    barrier = load_platform("jackal").protection["barrier"]
    text = protection_text(protection("jackal", "barrier"))
    for name in ("others_speed", "unseen_extent", "margin", "braking_linear", "keep_out"):
        assert f" {barrier[name]:g} m" in text, name
    assert "sensor" not in protection_text(protection("burger", "barrier"))


@pytest.mark.parametrize(("profile", "is_open"), [("dev", False), ("field", True)])
def test_a_robot_that_no_other_computer_reaches_says_so(
    tmp_path: Path, profile: str, is_open: bool
) -> None:
    network: dict[str, Any] = {"swarm": "meadow", "interface": "lo", "insecure": True}
    finding = _check_network(settings_of(tmp_path, profile=profile, **network))
    assert finding.is_well
    assert ("no other computer reaches this robot" in finding.text) is not is_open


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, ["stops by itself"]),
        ({"command_timeout": 0.25}, ["0.25 s"]),
        ({"command_timeout": 0.5, "idle_output": "silent"}, ["0.5 s", "while idle"]),
        ({"command_timeout": "none"}, ["configured", "watchdog"]),
    ],
)
def test_how_the_base_stops_is_explained(
    tmp_path: Path, options: Mapping[str, Value], words: list[str]
) -> None:
    settings = settings_of(tmp_path, driver_options=dict(options))
    text = command_timeout_text(settings, make_driver(settings))
    assert all(word in text for word in words)


def test_a_driver_with_its_own_process_needs_no_watchdog(tmp_path: Path) -> None:
    settings = settings_of(tmp_path, platform="burger", driver="ros1")
    assert "process of the driver" in command_timeout_text(settings, make_driver(settings))


@pytest.mark.integration
def test_parameters_that_no_pattern_takes_are_found(tmp_path: Path) -> None:
    settings = settings_of(
        tmp_path,
        "labels: {red: [r1]}\nparameters:\n"
        "  labels: {red: {drve: {linear: 0.1}}}\n"
        "  robots: {r1: {drive: {sped: 0.1, speed: 1000}}}\n",
    )
    unknown_pattern, unknown_parameter, out_of_range = faults(check_patterns(settings))
    assert "'drive'" in unknown_pattern
    assert "'speed'" in unknown_parameter
    assert "speed is 1000" in out_of_range


@pytest.mark.integration
def test_touch_zones_are_compared_with_what_patterns_ask_for(tmp_path: Path) -> None:
    settings = settings_of(
        tmp_path,
        f"plugin_dir: {EXAMPLES}\n"
        "touch: {push: {half_width_deg: 10, speed: 0.1}, pusch: {half_width_deg: 9, speed: 0.1}}",
    )
    granted, unknown = (one for one in check_patterns(settings) if one.subject == "touch")
    assert granted.is_well
    assert "10 deg" in granted.text
    assert "20 deg" in granted.text
    assert not unknown.is_well
    assert "'push'" in unknown.text


def test_a_driver_with_a_pose_makes_patterns_of_neighbors_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    needs = {"lloyd_coverage": ["neighbors.bearing", "scan"], "foraging": ["gripper"]}
    described = [
        {"name": name, "needs": given, "missing": given, "refused": "", "params": []}
        for name, given in needs.items()
    ]
    monkeypatch.setattr(preflight, "describe_patterns", lambda *_: described)
    posed: dict[str, Any] = {"driver": "ros2dds", "driver_options": {"shared_pose": "/pose"}}
    for values, misfits in ((posed, "foraging"), ({}, "lloyd_coverage, foraging")):
        values["platform"] = "epuck2"  # its sensors show no robot
        found = check_patterns(settings_of(tmp_path, **values))
        (text,) = (one.text for one in found if one.subject == "patterns")
        assert text.partition("not for this platform: ")[2].partition(";")[0] == misfits


@pytest.mark.integration
def test_missions_are_checked_for_the_platform_of_the_robot(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(
        "mission: Distances for TurtleBots\n"
        "parts: {vote: {pattern: majority_rule}, move: {pattern: dispersion}}\n"
        "map: [{from: vote.opinion, to: move.distance, values: [0.6, 1.3, 1.4]}]\n"
        "parallel: [vote, move]\ndrives: move\n"
    )
    found = {
        platform: {
            finding.subject: finding
            for finding in check_patterns(
                settings_of(tmp_path, platform=platform, plugin_dir=str(tmp_path))
            )
        }
        for platform in ("burger", "jackal")
    }
    assert "pattern own" not in found["burger"]  # it is among those that fit
    assert not found["jackal"]["pattern own"].is_well
    assert "own.yaml:3: map[0]" in found["jackal"]["pattern own"].text
    shipped = found["jackal"]["patterns"]
    assert shipped.is_well
    assert "discuss_then_disperse" in shipped.text.partition("not for this platform: ")[2]
    assert not [
        one for one in found["jackal"] if one.startswith("pattern ") and one != "pattern own"
    ]


@pytest.mark.integration
def test_the_driver_gets_the_rest_of_five_seconds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given: list[float] = []

    class PromptDriver:
        is_simulated = True

        async def check(self, seconds: float) -> tuple[Finding, ...]:
            given.append(seconds)
            return (Finding("scan", True, "5.0 Hz"),)

    monkeypatch.setattr(
        "swarmd.operator.cli.preflight.make_driver", lambda settings: PromptDriver()
    )
    assert check_daemon(settings_of(tmp_path)) == 0
    assert 3.0 <= given[0] < 5.0
    assert "scan 5.0 Hz" in " ".join(capsys.readouterr().out.split())


@pytest.mark.integration
def test_a_wrong_option_of_the_driver_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = settings_of(tmp_path, driver_options={"command_timeout": "never"})
    assert check_daemon(settings) == 1
    (line,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("fault"))
    assert "driver simulated" in line
    assert "'never'" in line


@pytest.mark.parametrize(
    ("platform", "limits"), [("burger", "up to 0.22 m/s and"), ("rosbot_xl", "0.8 m/s sideways")]
)
def test_the_limits_of_the_platform_are_named(tmp_path: Path, platform: str, limits: str) -> None:
    assert limits in _platform_text(settings_of(tmp_path, platform=platform))


def test_the_fence_is_told_and_must_have_room_for_the_robot(tmp_path: Path) -> None:
    def given(side: float) -> DaemonSettings:
        corners = [[0, 0], [side, 0], [side, side], [0, side]]
        fence = {"frame": "mocap", "polygon": corners, "without_pose": "drive"}
        return settings_of(tmp_path, json.dumps({"fence": fence}), platform="jackal")

    (layer,) = given(4.0).robot.layers.values()
    assert layer.text == (
        "4 corners in frame 'mocap'; keeps 0.05 m of margin; without a fresh pose the robot drives"
        " on without the fence"
    )
    with pytest.raises(ConfigError, match=r"r\.yaml: fence is too small for platform jackal: its"):
        given(0.6)


@pytest.mark.integration
@pytest.mark.parametrize(
    ("given", "is_well", "text"),
    [
        ({"below": 0.25}, True, "below 0.25 the robot stands, until 0.35"),
        ({"below": 0.2, "pattern": "drive"}, True, "below 0.2 the robot runs drive, until 0.3"),
        ({"below": 0.2, "pattern": "driv"}, False, "did you mean 'drive'"),
        ({"below": 0.2, "pattern": "drive", "params": {"sped": 0.1}}, False, "sped"),
        ({"below": 0.2, "pattern": "drive", "params": {"speed": 99.0}}, False, "speed"),
    ],
)
def test_what_a_low_battery_does_is_told(
    tmp_path: Path, given: dict[str, object], is_well: bool, text: str
) -> None:
    settings = settings_of(tmp_path, json.dumps({"on_low_battery": given}))
    (told,) = (row for row in check_patterns(settings) if row.subject == "low battery")
    assert told.is_well is is_well
    assert text in told.text
    assert "on_low_battery: {below: " in effective_config(settings)


@pytest.mark.integration
def test_the_runs_of_services_are_checked_as_a_run_would_be(tmp_path: Path) -> None:
    runs: dict[str, dict[str, Any]] = {
        "well": {"pattern": "attraction", "params": {"speed": 0.1}, "until": ["nearer:0.3"]},
        "absent": {"pattern": "attracton"},
        "misnamed": {"pattern": "attraction", "params": {"sped": 0.1}},
        "too_fast": {"pattern": "attraction", "params": {"speed": 100.0}},
        "blind": {"pattern": "collective_perception"},
    }
    options: dict[str, Any] = {"services": {"operator": "ros", "runs": runs}}
    settings = settings_of(tmp_path, platform="burger", driver="ros2dds", driver_options=options)
    found = {
        one.subject.rpartition(".")[2]: one.text
        for one in _check_commands(settings, make_driver(settings))
        if not one.is_well
    }
    assert found.keys() == runs.keys() - {"well"}
    for name, word in {
        "absent": "'attraction'",
        "misnamed": "'speed'",
        "too_fast": "speed is 100",
        "blind": "reading:ground",
    }.items():
        assert word in found[name]


@pytest.mark.parametrize("role", [None, Role.VIEWER])
def test_the_runs_of_a_name_that_is_no_operator_are_refused(
    tmp_path: Path, role: Role | None
) -> None:
    runs = {"go": {"pattern": "drive"}}
    options: dict[str, Any] = {"services": {"operator": "ros", "runs": runs}}
    settings = settings_of(tmp_path, driver="rmw_zenoh", driver_options=options)
    identity: Any = SimpleNamespace(roster=SimpleNamespace(generation=3, role_of={"ros": role}.get))
    secured = replace(settings, identity=identity)
    told = faults(_check_commands(secured, make_driver(settings)))
    subjects = {line.partition(":")[0] for line in told}
    assert subjects == {"/swarmd/stop", "/swarmd/estop", "services.runs.go"}


def test_the_commands_that_a_permit_does_not_permit_are_refused(tmp_path: Path) -> None:
    runs = {"go": {"pattern": "flocking"}, "fast": {"pattern": "drive", "params": {"speed": 0.2}}}
    options: dict[str, Any] = {"services": {"operator": "ros", "runs": runs}}
    settings = settings_of(tmp_path, driver="rmw_zenoh", driver_options=options)
    permit = KeyPermit(role="ros", key=bytes(64), may=("stop", "run drive"), until=2**33)
    roster = Roster(swarm="lab", generation=3, secret_digest=bytes(32), permits={"ros": permit})
    identity: Any = SimpleNamespace(roster=roster)
    secured = replace(settings, identity=identity)
    told = faults(_check_commands(secured, make_driver(settings)))
    subjects = {line.partition(":")[0] for line in told}
    assert subjects == {"/swarmd/estop", "services.runs.fast", "services.runs.go"}


@pytest.mark.long
@pytest.mark.usefixtures("open_firewall")
def test_a_check_goes_on_without_the_folder_of_patterns(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = {"on_low_battery": {"below": 0.2, "pattern": "drive"}, "plugin_dir": "absent"}
    assert check_daemon(settings_of(tmp_path, json.dumps(given))) == 1
    assert re.search("fault +patterns", capsys.readouterr().out)


def test_accepted_platforms_that_swarmd_does_not_have_are_named(tmp_path: Path) -> None:
    given = {"id": "r1", "platform": "burger", "accepts_unseen": ["burgr", "thymio"]}
    settings = load_daemon_settings(None, given, {"HOME": str(tmp_path)})
    text = peers_text(settings)
    assert text.endswith("waffle_pi_lds02 (faster); accepts burgr: no platform of swarmd")
