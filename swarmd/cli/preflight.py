"""`swarmd --check`: looks at everything a run would need and moves nothing."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from time import monotonic
from typing import Any

import click

from swarmd.cli.inspect import Row, describe_patterns
from swarmd.core.errors import SwarmError, unknown
from swarmd.daemon.driver_factory import make_driver
from swarmd.driver_api.driver import Driver, Finding, check_protected
from swarmd.driver_api.watchdog_client import WatchedDriver
from swarmd.kit.touch import describe_zone
from swarmd.plugins import pattern_names
from swarmd.settings.driver_options import base_options, effective_command_timeout
from swarmd.settings.settings import DaemonSettings

_SECONDS = 4.2  # of five in which all is said; the rest goes into starting Python, and ending
_DRIVER_SECONDS = 3.0  # at least; else what the rest leaves
_LEAVING = 0.2  # to close what it opened


def check_daemon(settings: DaemonSettings) -> int:
    """Print what was found, one line each; 0 if all is well, else 1."""
    begun = monotonic()
    findings = [*_findings(settings)]
    findings += _driver(settings, begun + _SECONDS)
    width = max(len(finding.subject) for finding in findings)
    for finding in findings:
        mark = "ok  " if finding.is_well else "FAIL"
        click.echo(f"{mark}  {finding.subject.ljust(width)}  {finding.text}")
    bad = sum(not finding.is_well for finding in findings)
    click.echo(
        f"{len(findings)} checked, {bad} not well" if bad else f"{len(findings)} checked, all well"
    )
    return 1 if bad else 0


def _findings(settings: DaemonSettings) -> Iterator[Finding]:
    yield Finding("settings", True, f"robot {settings.id} of swarm {settings.network.swarm}")
    yield Finding("platform", True, _platform_text(settings))
    yield _network(settings)
    yield _state_dir(settings.state_dir)
    yield from _roster(settings)
    yield from _patterns(settings)


def _platform_text(settings: DaemonSettings) -> str:
    platform = settings.platform
    limits = platform.limits
    return (
        f"{platform.name}: up to {limits.linear:g} m/s and {limits.angular:g} rad/s;"
        f" protection {protection_text(platform.protection)}"
    )


def protection_text(protection: Mapping[str, Any]) -> str:
    """The mode in force with its main numbers, from a platform's `protection`."""
    mode = protection["mode"]
    if mode == "barrier":
        told = protection["barrier"]
        text = (
            f"barrier ({told['responsibility']}): others come at up to {told['others_speed']:g}"
            f" m/s and reach {told['unseen_extent']:g} m beyond what is seen, {told['margin']:g} m"
            f" more is kept, brakes {told['braking_linear']:g} m/s2 and"
            f" {told['braking_angular']:g} rad/s2"
        )
        keep_out = told["keep_out"]
        return text if keep_out is None else f"{text}, nothing within {keep_out:g} m of the sensor"
    if mode == "stop_zone":
        told = protection["stop_zone"]
        share = f"{told['slow_share']:.0%} of the wish"
        return f"stop_zone: stops within {told['stop']:g} m, {share} within {told['slow']:g} m"
    if mode == "potential_field":
        return f"potential_field ({protection['preset']}) within {protection['threshold']:g} m"
    return f"{mode}: nothing keeps it from touching anything"


def _network(settings: DaemonSettings) -> Finding:
    interface = settings.network.interface_name
    known = [name for _, name in socket.if_nameindex()]
    if interface not in known:
        return Finding("network", False, unknown("network interface", interface, known))
    text = f"profile {settings.network.profile} on {interface}"
    if settings.network.profile == "field":
        text += "; without certificates anyone on this network can drive this robot"
    return Finding("network", True, text)


def _state_dir(folder: Path) -> Finding:
    """Whether the daemon can write there: tried, since modes do not tell; nothing is left."""
    there = folder.absolute()
    made: list[Path] = []
    try:
        lacking = [path for path in (there, *there.parents) if not path.exists()]
        for path in reversed(lacking):
            path.mkdir()
            made.append(path)
        with TemporaryFile(dir=there) as file:
            file.write(b"latches")
    except OSError as error:
        text = f"{folder} cannot be written to ({error.strerror}), so latches would be lost"
        return Finding("state_dir", False, f"{text}; give --state-dir")
    finally:
        for path in reversed(made):
            with suppress(OSError):  # another has put something into it meanwhile
                path.rmdir()
    return Finding("state_dir", True, str(folder))


def _roster(settings: DaemonSettings) -> Iterator[Finding]:
    if settings.roster and settings.id not in settings.roster:
        text = f"{unknown('robot in the roster', settings.id, settings.roster)}"
        yield Finding("roster", False, text)


def _patterns(settings: DaemonSettings) -> Iterator[Finding]:
    try:
        origins = pattern_names(settings.plugin_dir)
        own = pattern_names(settings.plugin_dir, {})
        rows = describe_patterns((), settings.plugin_dir, settings.platform_name)
    except SwarmError as error:
        yield Finding("patterns", False, str(error))
        return
    for row in rows:
        name = row["name"]
        if origins[name].rival:
            text = f"is there twice: {origins[name].source} and {origins[name].rival}"
            yield Finding(f"pattern {name}", False, f"{text}; rename one")
        elif "error" in row:
            yield Finding(f"pattern {name}", False, row["error"])
        elif row["missing"]:
            text = f"not for this platform, which lacks {', '.join(row['missing'])}"
            yield Finding(f"pattern {name}", True, text)
        elif row["refused"]:
            start = "" if name in own else "not for this platform: "
            yield Finding(f"pattern {name}", name not in own, start + row["refused"])
        else:
            yield Finding(f"pattern {name}", True, row["source"])
    by_name = {row["name"]: row for row in rows}
    yield from _configured(settings, by_name)
    yield from _touching(settings, by_name)


def _configured(settings: DaemonSettings, rows: Mapping[str, Row]) -> Iterator[Finding]:
    """Faults in the parameters that the files configure for this robot's patterns."""
    parameters = settings.parameters
    own = [parameters.labels.get(label, {}) for label in settings.labels]
    sections = (settings.platform.patterns, *own, parameters.robots.get(settings.id, {}))
    for name in sorted({name for section in sections for name in section} - rows.keys()):
        yield Finding("parameters", False, unknown("pattern", name, rows))
    for name, row in rows.items():
        specs = {spec["name"]: spec for spec in row.get("params", ())}
        for source, values in settings.pattern_layers(name) if specs else ():
            for key, value in values.items():
                fault = _parameter_fault(specs, key, value)
                if fault:
                    yield Finding("parameters", False, f"{source}: {name}: {fault}")


def _touching(settings: DaemonSettings, rows: Mapping[str, Row]) -> Iterator[Finding]:
    """Each pattern that may touch what is near, and whether it asks to."""
    for name, zone in settings.touch_zones.items():
        if name not in rows:
            yield Finding("touch", False, unknown("pattern", name, rows))
            continue
        asked = rows[name].get("touches") or "nothing"
        yield Finding("touch", True, f"{name}: granted {describe_zone(zone)}; it asks for {asked}")


def _parameter_fault(specs: Mapping[str, Row], key: str, value: object) -> str:
    """What the pattern host would object to, as far as names and bounds tell; else empty."""
    if key not in specs:
        return unknown("parameter", key, specs)
    spec = specs[key]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if is_number != (spec["type"] in ("int", "float")) and not isinstance(value, str | None):
        return f"{key} is {value!r}; wanted {spec['wanted']}"
    low, high = spec["ge"], spec["le"]
    if isinstance(value, int | float) and not (
        (low is None or value >= low) and (high is None or value <= high)
    ):
        return f"{key} is {value!r}; wanted {spec['wanted']}"
    return ""


def _driver(settings: DaemonSettings, until: float) -> Iterator[Finding]:
    """What the driver sees by `until`, on the monotonic clock, and how its base stops."""
    subject = f"driver {settings.driver}"
    try:
        driver = make_driver(settings)
        yield from asyncio.run(driver.check(max(until - monotonic() - _LEAVING, _DRIVER_SECONDS)))
        yield Finding("command_timeout", True, command_timeout_text(settings, driver))
        check_protected(settings.platform, driver, settings.driver)
    except SwarmError as error:
        yield Finding(subject, False, str(error))


def command_timeout_text(settings: DaemonSettings, driver: Driver) -> str:
    """How the base stops when its daemon is lost."""
    base = base_options(settings.driver_options, f"driver {settings.driver}")
    command_timeout = effective_command_timeout(base, driver)
    if command_timeout == "none":
        source = (
            "so its platform says" if base.command_timeout else "so it is taken, as none is told"
        )
        who = "a stopper" if isinstance(driver, WatchedDriver) else "a process of its driver"
        text = f"the base never stops by itself ({source}); {who} says zero for a lost daemon"
    else:
        after = "" if command_timeout == "base" else f" after {command_timeout:g} s"
        text = f"the base stops by itself{after} when commands end"
    return text if base.idle_output == "zeros" else f"{text}; while idle it is left to others"
