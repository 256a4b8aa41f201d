"""The manifest of an experiment: everything needed to repeat it bit by bit."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

import swarmd
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.files import as_text, read_regular, user_path, whole_file
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.sim.experiments.plan import Plan, Shard, Variant, check_seeds
from swarmd.sim.experiments.pool import worker_functions
from swarmd.sim.experiments.provenance import (
    GitState,
    deciding,
    digests_of_folders,
    git_state,
    made_with,
)
from swarmd.sim.metrics.catalog import metric_of
from swarmd.sim.metrics.metric import Better, Metric
from swarmd.sim.metrics.reported import PREFIXES

NAME = "manifest.json"
FORMAT = 1
PROCESSOR = ("machine", "processor", "simd", "libm", "functions", "libc", "blas", "pinned")
"""The keys of `made_with` that depend on the machine, which changes last bits at most."""
_CAUSES = (
    *("code", "pinned", "libm", "functions", "mujoco", "numpy", "scipy", "python"),
    *("simd", "blas", "kernels"),
)
"""Keys of `made_with`, the likeliest cause of other results first; others are hardly a cause.
`libm` and `functions` compare results, the others names; kernels give equal bits compiled and
interpreted."""
_TEXTS = {
    "code": "swarmd's code has changed",
    "libm": "the C library's mathematical functions give other last bits here",
    "functions": "sums and functions of numpy or of the C library give other last bits here",
    "pinned": "only one of both was pinned to the functions that every x86-64 has",
    "simd": "the processor is another, with other instructions for numpy",
}


class _Format(msgspec.Struct):
    format: int


class OwnMetric(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A metric beyond the catalog that an experiment measures; the fields are those of Metric.

    The manifest keeps the fields for the case that the metric's code is missing later.
    """

    name: str
    origin: str
    unit: str
    better: Better | None
    is_time_to_event: bool


class Manifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The runs of an experiment, and the software that made them."""

    format: int
    created: str  # in UTC
    command: list[str]  # the command line that repeats the experiment, empty if made from Python
    scenario: str  # the name as given
    seeds: list[int]
    sets: dict[str, Any]  # by dotted key
    sweep: dict[str, list[Any]]  # by dotted key
    traces: bool  # whether traces are kept
    made_with: dict[str, str]  # versions, and the digest of the code
    git: dict[str, GitState | None]  # checkouts of swarmd and of the scenario's folder, or None
    plugins: dict[str, str]  # digests of patterns by path, and of custom metrics by origin
    variants: list[Variant]  # with the complete scenarios
    shard: Shard | None = None  # the part of the runs that the folder holds, None for all
    metrics: list[OwnMetric] = []  # beyond the catalog
    shown: list[str] = []  # names of the metrics that the user asked for
    report_units: dict[str, str] = {}  # by the keys of reports, as the patterns declare them

    @property
    def plan(self) -> Plan:
        """The plan of the runs, made from the manifest alone without the scenario's file."""
        return Plan(
            scenario=self.scenario,
            seeds=check_seeds(self.seeds),
            variants=tuple(self.variants),
            sets=self.sets,
            sweep=self.sweep,
            shard=self.shard,
        )


def manifest_of(
    plan: Plan,
    *,
    traces: bool,
    command: list[str],
    metrics: Iterable[Metric] = (),
    shown: Iterable[str] = (),
    functions: Mapping[str, str] | None = None,
) -> Manifest:
    """The manifest of a plan: its runs, and the software that is installed now.

    `traces`: whether traces are kept. `command`: the command line that repeats the experiment.
    `metrics`: custom metrics to measure in addition to the catalog. `shown`: names of the metrics
    that the user asked for. `functions`: what the process computes with that simulates; None: a
    worker of this process. ConfigError if two custom metrics have the same name, or if a path is
    not UTF-8.
    """
    units = _report_units(plan)
    # A metric of a report or reading gets the unit that the plan's patterns declare.
    custom = [
        metric_of(metric.name, report_units=units) if metric.name.startswith(PREFIXES) else metric
        for metric in metrics
    ]
    _check_names(custom)
    scenario_file = Path(plan.scenario)
    is_file = scenario_file.is_file()  # else the name of a scenario that comes with swarmd
    manifest = Manifest(
        format=FORMAT,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        command=command,
        scenario=plan.scenario,
        seeds=list(plan.seeds),
        sets=plain(plan.sets),
        sweep=plain(plan.sweep),
        traces=traces,
        made_with=made_with(worker_functions() if functions is None else functions),
        git={
            "swarmd": git_state(Path(swarmd.__file__).resolve().parent),
            "scenario": git_state(scenario_file.resolve().parent) if is_file else None,
        },
        plugins={
            **digests_of_folders(plugin_folders(plan)),
            **{metric.origin: metric.digest for metric in custom if metric.digest},
        },
        variants=[Variant(v.name, plain(v.values), plain(v.effective)) for v in plan.variants],
        shard=plan.shard,
        metrics=[_entry(metric) for metric in custom],
        shown=[*shown],
        report_units=units,
    )
    try:
        msgspec.json.encode(manifest)
    except UnicodeEncodeError as error:
        as_text(error.object)  # raises ConfigError that names the text
    return manifest


def _check_names(metrics: Sequence[Metric]) -> None:
    """ConfigError if two metrics have the same name."""
    names = [metric.name for metric in metrics]
    if (repeated := next((name for name in names if names.count(name) > 1), None)) is not None:
        raise ConfigError(f"two metrics are named {repeated}; rename a file or a function")


def _entry(metric: Metric) -> OwnMetric:
    """The entry of a custom metric, with the origin by which `metric_of` finds the metric again.

    The origin of a metric that is not in a file is its name.
    """
    entry = msgspec.convert(metric, OwnMetric, from_attributes=True)
    return msgspec.structs.replace(entry, origin=entry.origin or entry.name)


def plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values after a round trip through JSON, so that runs and manifest have equal values.

    SwarmError for a value that JSON cannot hold, such as infinity.
    """
    try:
        text = json.dumps(values, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise SwarmError(f"the scenario cannot be written as JSON: {error}") from error
    data: dict[str, Any] = json.loads(text)
    return data


def read_manifest(folder: Path) -> Manifest:
    """The manifest of an experiment's folder; ConfigError if it is missing or damaged."""
    path = folder / NAME
    try:
        data = read_regular(path)
        version = msgspec.json.decode(data, type=_Format).format
        if version == FORMAT:
            manifest = msgspec.json.decode(data, type=Manifest)
            check_seeds(manifest.seeds)
            if manifest.variants:
                return manifest
            raise ConfigError("no variants")
    except (FileNotFoundError, NotADirectoryError):
        text = f"{folder}: no experiment: there is no folder with a {NAME}"
        raise ConfigError(f"{text}; name one that `swarmctl exp run SCENARIO` has made") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, ConfigError, RecursionError) as error:
        text = f"{path}: damaged: {' '.join(str(error).split())[:200]}"
        raise ConfigError(f"{text}; restore it, or run the experiment again") from error
    text = f"{path}: format {version}, and this swarmd reads {FORMAT}"
    raise ConfigError(f"{text}; use the swarmd that has made it")


def differences(old: Manifest, new: Manifest) -> Iterator[str]:
    """A text for each difference that changes results or files."""
    for name in ("scenario", "seeds", "sets", "sweep", "traces", "shard"):
        was = getattr(old, name)
        now = getattr(new, name)
        # The order of swept keys is the order of the rows.
        if was != now or (name == "sweep" and list(was) != list(now)):
            yield f"{name} was {_clipped(was)}, now {_clipped(now)}"
    was, now = ([metric.origin for metric in side.metrics] for side in (old, new))
    if was != now:
        yield f"metrics were {_clipped(was)}, now {_clipped(now)}"
    if (old.sets, old.sweep) == (new.sets, new.sweep) and (
        [v.effective for v in old.variants] != [v.effective for v in new.variants]
    ):
        yield "the scenario's contents have changed"
    yield from software_differences(old, new)


def software_differences(old: Manifest, new: Manifest) -> Iterator[str]:
    """A text for each difference of versions, code, plugins and machine, likeliest cause first."""
    for name in sorted({*old.plugins, *new.plugins}):
        if old.plugins.get(name) != new.plugins.get(name):
            yield f"plugin {name} has changed"
    before = old.made_with
    after = new.made_with
    if before.get("pinned") == after.get("pinned"):
        before = deciding(before)
        after = deciding(after)
    others = sorted({*before, *after} - set(_CAUSES))
    for name in (*_CAUSES, *others):
        was = before.get(name, "unknown")
        now = after.get(name, "unknown")
        if was != now:
            is_known = name in before and name in _TEXTS
            yield _TEXTS[name] if is_known else f"{name} was {was}, now {now}"


def _report_units(plan: Plan) -> dict[str, str]:
    """The units of reports that the plan's patterns declare; without keys with several units."""
    running: dict[tuple[str | None, str], None] = {}
    for scenario in (variant.effective for variant in plan.variants):
        names = [group.get("pattern") for group in scenario.get("groups", {}).values()]
        names += [event.get("run") for event in scenario.get("events", ())]
        running |= dict.fromkeys((scenario.get("plugin_dir"), name) for name in names if name)
    units: dict[str, set[str]] = {}
    for folder, name in running:
        with suppress(SwarmError):  # a folder that is no longer there
            origin = pattern_names(None if folder is None else user_path(folder)).get(name)
            if origin is None:  # the scenario's check names it
                continue
            kind = PatternLoader({name: (origin.value, origin.is_file)})(name)
            for key, unit in kind.report_units.items():
                units.setdefault(key, set()).add(unit)
    return {key: of.pop() for key, of in units.items() if len(of) == 1}


def plugin_folders(plan: Plan) -> list[str]:
    """The plugin folders of all variants; ConfigError for a value that is no path."""
    named = [variant.effective.get("plugin_dir") for variant in plan.variants]
    for folder in named:
        if not isinstance(folder, str | None) or "\0" in (folder or ""):
            raise ConfigError(f"plugin_dir is {_clipped(folder)!r}; expected a folder, or null")
    return sorted({folder for folder in named if folder is not None})


def joined(a: Manifest, b: Manifest) -> Manifest:
    """The manifest `a`, with the processors of both manifests."""
    both = {name: " or ".join(sorted({*_either(a, name), *_either(b, name)})) for name in PROCESSOR}
    return msgspec.structs.replace(a, made_with={**a.made_with, **both})


def _either(manifest: Manifest, name: str) -> list[str]:
    return manifest.made_with.get(name, "unknown").split(" or ")


def write_json(path: Path, data: Any) -> None:
    """Write a JSON file atomically."""
    write_whole(path, json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def write_whole(path: Path, text: str) -> None:
    """Write a text file atomically; a failure leaves no partial file."""
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def _clipped(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
