"""`swarmd --print-effective-config`: every setting and its source."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from msgspec import to_builtins

from swarmd.core.values import Platform, ScanSpec, Sweep
from swarmd.settings.settings import DaemonSettings
from swarmd.settings.yamlfile import text_of

_COLUMN = 40


def effective_config(settings: DaemonSettings) -> str:
    """The settings as YAML, which `swarmd --config` reads back to the same settings.

    A comment names the source of each value. The values of the platform follow as comments, since
    the key `platform` stands for them.
    """
    file = settings.file
    folder = settings.plugin_dir
    values = to_builtins(file) | {
        "id": settings.id,
        "identity": None if settings.identity is None else str(settings.identity.folder.absolute()),
        "platform": settings.platform_name,
        "driver_options": dict(settings.driver_options),
        "roster": list(settings.roster),
        "labels": {label: list(robots) for label, robots in file.members.items()},
        "state_dir": str(settings.state_dir.absolute()),
        "plugin_dir": str(folder.absolute()) if folder else None,
        "recording": to_builtins(settings.recording),
    }
    lines = [
        _line(f"{key}: {_flow(values[key])}", source) for key, source in settings.provenance.items()
    ]
    lines += ["", f"# platform {settings.platform.name}"]
    platform_values = _flat(_platform(settings.platform))
    lines += [f"#   {name}: {_flow(value)}" for name, value in platform_values]
    return "\n".join(lines) + "\n"


def _line(text: str, source: str) -> str:
    return f"{text.ljust(_COLUMN)}  # {source}"


def _flow(value: object) -> str:
    return text_of(value, flow=True, width=math.inf).removesuffix("\n").removesuffix("\n...")


def _platform(platform: Platform) -> Mapping[str, Any]:
    return {
        "limits": to_builtins(platform.limits),
        "footprint": platform.footprint.tolist(),
        "scan": _scan(platform.scan),
        "ranges": None if platform.ranges is None else _scan(platform.ranges),
        "heights": None if platform.heights is None else to_builtins(platform.heights),
        "provides": sorted(platform.provides),
        "protection": dict(platform.protection),
        "patterns": platform.patterns,
        "body": dict(platform.body),
    }


def _scan(scan: ScanSpec) -> Mapping[str, Any]:
    return {
        "rays": len(scan.bearings),
        "cone_deg": round(math.degrees(scan.cone), 6),
        "rate": scan.rate,
        "range_min": scan.range_min,
        "range_max": scan.range_max,
        "offset": list(scan.offset),
        "max_gap_deg": round(math.degrees(scan.max_gap), 6),
        "zero": scan.zero,
        "noisy": scan.is_noisy,
        "near": scan.near,
        "latency": scan.latency,
        "sweep": "unknown" if scan.is_sweep_unknown else _sweep(scan.sweep),
        "mask": [[round(math.degrees(edge), 6) for edge in sector] for sector in scan.mask],
    }


def _sweep(sweep: Sweep | None) -> Mapping[str, Any] | None:
    if sweep is None:
        return None
    return {
        "start_deg": round(math.degrees(sweep.start), 6),
        "direction": "ccw" if sweep.direction > 0.0 else "cw",
        "duration": sweep.duration,
    }


def _flat(data: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value
