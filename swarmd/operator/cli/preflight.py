"""`swarmd --check`: checks everything that a run needs; moves nothing."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator, Mapping, Sequence
from time import monotonic
from typing import Any

import msgspec

from swarmd.core.errors import SwarmError, unknown
from swarmd.core.finding import Finding
from swarmd.core.host_messages import REQUEST_LAYER
from swarmd.core.kernels import describe_kernels
from swarmd.core.machine import measure_machine
from swarmd.daemon.driver import make_driver
from swarmd.daemon.driver_commands import command_fault
from swarmd.driver_api.command_source import command_source
from swarmd.driver_api.driver import Driver, check_protected
from swarmd.driver_api.watchdog_client import WatchedDriver
from swarmd.kit.touch import describe_zone, granted_zones
from swarmd.link.carriers.network_facts import measure_network
from swarmd.link.settings import ONLY_HERE
from swarmd.operator.cli.findings import HERE, Line, exit_code_of, print_findings
from swarmd.operator.cli.plugin_check import Record, check_runs, describe_patterns, parameter_fault
from swarmd.operator.texts.doctor import of_machine, of_network
from swarmd.operator.texts.status import passage_text, set_down_text
from swarmd.plugins import Origin, pattern_names
from swarmd.robot.protection.compatibility import Accepts, assumed_speed, body_of, findings
from swarmd.robot.protection.modes import make_mode, narrowest_passage
from swarmd.robot.protection.set_down import set_down
from swarmd.robot.protection.settings import SLOW_SHARE, BarrierSettings
from swarmd.settings.driver_options import base_options, effective_command_timeout
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.settings.settings import DaemonSettings

CHECK_TIMEOUT = 4.2  # s for all checks: with starting and ending Python, 5 s
MIN_DRIVER_TIMEOUT = 3.0  # s for the driver, even if the other checks took long
CLOSE_TIMEOUT = 0.2  # s for the driver to close its connections


def check_daemon(settings: DaemonSettings) -> int:
    """Print the findings; 0 without a fault, else 1."""
    lines = [Line(HERE, finding) for finding in findings_of(settings)]
    print_findings(lines)
    return exit_code_of(lines)


def findings_of(settings: DaemonSettings) -> list[Finding]:
    """The findings on everything that a run of this robot needs; moves nothing."""
    deadline = monotonic() + CHECK_TIMEOUT
    return [
        Finding("settings", True, f"robot {settings.id} of swarm {settings.network.swarm}"),
        Finding("platform", True, _platform_text(settings)),
        *_check_passage(settings),
        Finding("peers", True, peers_text(settings)),
        *[Finding(key, True, layer.text) for key, layer in settings.robot.layers.items()],
        Finding("kernels", True, describe_kernels()),
        _check_network(settings),
        *of_network(measure_network(settings.network.interface_name), is_robot=False),
        *of_machine(measure_machine((("state", settings.state_dir),))),
        *_check_roster(settings),
        *check_patterns(settings),
        *_check_driver(settings, deadline),
    ]


def _platform_text(settings: DaemonSettings) -> str:
    platform = settings.platform
    limits = platform.limits
    sideways = f", {limits.lateral:g} m/s sideways" if limits.lateral > 0.0 else ""
    return (
        f"{platform.name}: up to {limits.linear:g} m/s{sideways} and {limits.angular:g} rad/s;"
        f" protection {protection_text(platform.protection)}"
    )


def _check_passage(settings: DaemonSettings) -> list[Finding]:
    """The narrowest passages of mode `barrier`, and the distance from walls at the start.

    Other modes have none.
    """
    passage = narrowest_passage(make_mode(settings.platform))
    place = set_down(settings.platform, passage)
    findings = [] if passage is None else [Finding("passes", True, passage_text(passage))]
    return [
        *findings,
        *([] if place is None else [Finding("set down", True, set_down_text(place))]),
    ]


def peers_text(settings: DaemonSettings) -> str:
    """The platforms of swarmd whose robots make this robot stand, as text.

    All platforms of swarmd are compared, since the roster has only the names of the real peers, not
    their platforms. The settings `accepts_unseen` and `accepts_faster` may also name a platform
    that swarmd lacks, such as a file on another robot; the text says so.
    """
    own = body_of(settings.platform)
    speed = assumed_speed(settings.platform)
    granted = settings.robot
    accepts = Accepts.of(granted.accepts_unseen, granted.accepts_faster)
    held: list[str] = []
    for name in platform_names():
        peer = body_of(load_platform(name))
        for found in findings(own, speed, name, peer, accepts):
            if found.kind == "unknown":
                return "platform has no heights: whether this robot sees others is not known"
            if found.holds:
                held.append(f"{name} ({'not seen' if found.kind == 'unseen' else 'faster'})")
    accepted = {*accepts.unseen, *accepts.faster}
    foreign = sorted(accepted.difference(platform_names()))
    note = f"; accepts {', '.join(foreign)}: no platform of swarmd" if foreign else ""
    return (f"held beside {', '.join(held)}" if held else "fits all platforms of swarmd") + note


def protection_text(protection: Mapping[str, Any]) -> str:
    """The mode of protection with its main numbers, from a platform's `protection`."""
    mode = protection["mode"]
    if mode == "barrier":
        barrier = protection["barrier"]
        text = (
            "barrier: assumes obstacles of up to"
            f" {barrier['others_speed']:g} m/s that extend {barrier['unseen_extent']:g} m beyond"
            f" their returns, and braking with {barrier['braking_linear']:g} m/s2 and"
            f" {barrier['braking_angular']:g} rad/s2; keeps {barrier['margin']:g} m of margin"
        )
        keep_out = barrier["keep_out"]
        text = text if keep_out is None else f"{text}, and {keep_out:g} m around the sensor"
        settings = msgspec.convert(barrier, BarrierSettings)
        return "; ".join([text, *[layer.text for layer in settings.layers.values()]])
    if mode == "stop_zone":
        zone = protection["stop_zone"]
        share = f"{SLOW_SHARE:.0%} of the requested speed"
        return f"stop_zone: stops within {zone['stop']:g} m, {share} within {zone['slow']:g} m"
    if mode == "potential_field":
        return f"potential_field ({protection['preset']}) within {protection['threshold']:g} m"
    return f"{mode}: nothing prevents collisions"


def _check_network(settings: DaemonSettings) -> Finding:
    text = f"profile {settings.network.profile} on {settings.network.interface_name}"
    if settings.identity is not None:
        text += f", secured as {settings.identity.name}"
    elif settings.network.profile != "dev":
        text += "; insecure: anyone on this network can drive this robot"
    if settings.network.profile == "dev":
        text += f"; {ONLY_HERE}"
    return Finding("network", True, text)


def _check_roster(settings: DaemonSettings) -> Iterator[Finding]:
    if settings.roster and settings.id not in settings.roster:
        text = f"{unknown('robot in the roster', settings.id, settings.roster)}"
        yield Finding("roster", False, text)


def _pattern_fault(row: Record, origin: Origin, *, is_in_plugin_dir: bool) -> str | None:
    """The fault of a pattern; None without a fault.

    A pattern that does not fit this platform has no fault. A pattern that a robot refuses has a
    fault only in `plugin_dir`, where the owner has put the pattern to run it. `row`: the
    description of the pattern. `row["missing"]`: what the pattern needs and the platform lacks.
    `row["refused"]`: why a robot refuses the pattern.
    """
    if origin.rival:  # a second file or package with this name
        return f"exists twice: {origin.source} and {origin.rival}; rename one"
    if "error" in row:
        return str(row["error"])
    is_refused = bool(row["refused"]) and not row["missing"]
    if is_refused and is_in_plugin_dir:
        return str(row["refused"])
    return None


def check_patterns(settings: DaemonSettings) -> Iterator[Finding]:
    """Yields findings about the patterns of this robot, with their parameters and touch zones.

    Each pattern with a fault gets a finding of its own (see `_pattern_fault`). A further finding
    has the number of patterns that fit the platform, and the names of patterns that do not fit.
    """
    try:
        origins = pattern_names(settings.plugin_dir)
        # The patterns of the folder, without those of packages.
        in_plugin_dir = pattern_names(settings.plugin_dir, installed={})
        rows = describe_patterns((), settings.plugin_dir, settings.platform_name)
    except SwarmError as error:
        yield Finding("patterns", False, str(error))
        return
    fit_count = 0
    misfits: list[str] = []
    for row in rows:
        name = row["name"]
        # As the options of the driver add inputs to those of the platform.
        row["missing"] = sorted({*row.get("needs", ())} - settings.platform.provides)
        fault = _pattern_fault(row, origins[name], is_in_plugin_dir=name in in_plugin_dir)
        if fault is not None:
            yield Finding(f"pattern {name}", False, fault)
        elif row["missing"] or row["refused"]:
            misfits.append(name)
        else:
            fit_count += 1
    why = f"swarmctl patterns show NAME --platform {settings.platform_name}"
    misfit_text = f"; not for this platform: {', '.join(misfits)}; why: {why}" if misfits else ""
    text = f"{fit_count} of {len(rows)} fit this platform{misfit_text}"
    yield Finding("patterns", True, text)
    rows_by_name = {row["name"]: row for row in rows}
    yield from _check_parameters(settings, rows_by_name)
    yield from _check_touch(settings, rows_by_name)
    yield from _check_low_battery(settings)


def _check_parameters(settings: DaemonSettings, rows: Mapping[str, Record]) -> Iterator[Finding]:
    """Faults in the configured parameters of this robot's patterns."""
    parameters = settings.parameters
    own = [parameters.labels.get(label, {}) for label in settings.labels]
    sections = (settings.platform.patterns, *own, parameters.own)
    for name in sorted({name for section in sections for name in section} - rows.keys()):
        yield Finding("parameters", False, unknown("pattern", name, rows))
    for name, row in rows.items():
        specs = {spec["name"]: spec for spec in row.get("params", ())}
        for source, values in parameters.layers(name, settings.labels) if specs else ():
            for key, value in values.items():
                fault = parameter_fault(specs, key, value)
                if fault:
                    yield Finding("parameters", False, f"{source}: {name}: {fault}")


def _check_touch(settings: DaemonSettings, rows: Mapping[str, Record]) -> Iterator[Finding]:
    """Each pattern with a touch zone, and whether the pattern asks for it."""
    for name, zone in granted_zones(settings.robot.touch).items():
        if name not in rows:
            yield Finding("touch", False, unknown("pattern", name, rows))
            continue
        asked = rows[name].get("touches") or "nothing"
        yield Finding("touch", True, f"{name}: granted {describe_zone(zone)}; it asks for {asked}")


def _run(
    settings: DaemonSettings,
    name: str,
    pattern: str,
    params: Mapping[str, object],
    until: Sequence[str] = (),
) -> Record:
    """A run as `check_runs` takes it, with the configured parameters below its own."""
    return {
        "name": name,
        "pattern": pattern,
        "layers": (
            *settings.parameters.layers(pattern, settings.labels),
            (REQUEST_LAYER, dict(params)),
        ),
        "until": until,
        "provides": sorted(settings.platform.provides),
    }


def _check_commands(settings: DaemonSettings, driver: Driver) -> Iterator[Finding]:
    """A fault for each run of the driver's options that the robot would refuse."""
    source = command_source(driver)
    commands = {} if source is None else source.runs
    wall = time.time()
    refused = {
        name: why
        for name, command in commands.items()
        if (why := command_fault(command, settings.id, settings.identity, wall=wall))
    }
    runs = [
        _run(settings, name, run.pattern, run.params, run.until)
        for name, command in commands.items()
        if (run := command.run) is not None and name not in refused
    ]
    if runs:
        refused |= check_runs(runs, settings.plugin_dir, settings.platform_name)
    for name, why in refused.items():
        if why:
            yield Finding(name, False, f"a call would be refused: {why}")


def _check_low_battery(settings: DaemonSettings) -> Iterator[Finding]:
    """What the robot does at a low battery, or why it stands instead of running a pattern."""
    given = settings.robot.on_low_battery
    if given is None:
        return
    act = "stands"
    fault = ""
    if given.pattern is not None:
        act = f"runs {given.pattern}"
        run = _run(settings, act, given.pattern, given.params)
        fault = check_runs([run], settings.plugin_dir, settings.platform_name)[act]
    if fault:
        text = f"on_low_battery: {given.pattern}: {fault}; the robot stands instead"
        yield Finding("low battery", False, text)
    else:
        text = f"below {given.below:g} the robot {act}, until {given.until:g}"
        yield Finding("low battery", True, text)


def _check_driver(settings: DaemonSettings, deadline: float) -> Iterator[Finding]:
    """The findings of the driver until `deadline` (monotonic), and how its base stops."""
    subject = f"driver {settings.file.driver}"
    try:
        driver = make_driver(settings)
        yield from _check_commands(settings, driver)
        timeout = max(deadline - monotonic() - CLOSE_TIMEOUT, MIN_DRIVER_TIMEOUT)
        yield from asyncio.run(driver.check(timeout))
        yield Finding("command_timeout", True, command_timeout_text(settings, driver))
        check_protected(settings.platform, driver, settings.file.driver)
    except SwarmError as error:
        yield Finding(subject, False, str(error))


def command_timeout_text(settings: DaemonSettings, driver: Driver) -> str:
    """How the base stops after the daemon has ended."""
    base = base_options(settings.driver_options, f"driver {settings.file.driver}")
    command_timeout = effective_command_timeout(base, driver)
    if command_timeout == "none":
        source = "configured" if base.command_timeout else "assumed, since none is configured"
        process = "the watchdog" if isinstance(driver, WatchedDriver) else "a process of the driver"
        text = f"the base has none ({source}); {process} commands zero if the daemon dies"
    else:
        after = "" if command_timeout == "base" else f" after {command_timeout:g} s"
        text = f"the base stops by itself{after} without commands"
    return text if base.idle_output == "zeros" else f"{text}; no commands are sent while idle"
