"""A manifest comes back as it was, or says in one line what is wrong or what differs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.experiments.manifest import (
    NAME,
    Manifest,
    differences,
    manifest_of,
    plain,
    read_manifest,
    write_json,
)
from swarmd.sim.experiments.simulate import plan_of

SPEED = "groups.all.parameters.speed"


@pytest.fixture
def manifest(duo: Path) -> Manifest:
    plan = plan_of(duo, (3, 1), {"duration": 1.5}, {SPEED: [0.1, 0.2]})
    return manifest_of(plan, traces=True, command=["swarmctl", "exp", "run"])


def test_comes_back_as_it_was_and_gives_the_same_runs(manifest: Manifest, tmp_path: Path) -> None:
    write_json(tmp_path / NAME, msgspec.to_builtins(manifest))
    again = read_manifest(tmp_path)
    assert again == manifest
    assert again.plan == manifest.plan
    assert [run.id for run in again.plan.runs][:2] == ["speed=0.1_s0003", "speed=0.1_s0001"]
    assert again.plan.variants[1].effective["duration"] == 1.5
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == [NAME]


def test_says_what_it_was_made_with(manifest: Manifest, duo: Path) -> None:
    made = manifest.made_with
    names = "swarmd python numpy mujoco scipy msgspec kernels code"
    machine = "machine processor libc libm functions simd blas pinned"
    assert set(made) == {*names.split(), *machine.split()}
    assert all(made.values())
    assert list(manifest.plugins) == [f"{duo.parent}/plugins/moody.py"]
    assert manifest.git["scenario"] is None
    assert manifest.created.endswith("+00:00")


@pytest.mark.parametrize(
    ("path", "value", "fault"),
    [
        (("format",), 99, "99"),
        (("seeds",), [], "seeds"),
        (("seeds",), [1, 1], "seeds: 1"),
        (("seeds",), "1", "$.seeds"),
        (("variants",), [], "variants"),
        (("variants", 0, "effective"), 3, "$.variants"),
        (("surprise",), 1, "surprise"),
    ],
)
def test_damage_is_one_line(
    manifest: Manifest, tmp_path: Path, path: tuple[str | int, ...], value: Any, fault: str
) -> None:
    data: Any = msgspec.to_builtins(manifest)
    holder = data
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    (tmp_path / NAME).write_text(json.dumps(data))
    with pytest.raises(ConfigError) as caught:
        read_manifest(tmp_path)
    assert f"{tmp_path / NAME}: " in str(caught.value)
    assert fault in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("data", [None, b"", b"{", b"[]", b"3", b"\xff\xfe", b"[" * 10**5, b"{}"])
def test_what_is_no_manifest_is_one_line(tmp_path: Path, data: bytes | None) -> None:
    if data is not None:
        (tmp_path / NAME).write_bytes(data)
    with pytest.raises(ConfigError, match=str(tmp_path)) as caught:
        read_manifest(tmp_path)
    assert "\n" not in str(caught.value)


def test_another_processor_is_a_difference_only_if_workers_were_not_pinned(
    manifest: Manifest,
) -> None:
    def elsewhere(**made: str) -> Manifest:
        return msgspec.structs.replace(manifest, made_with={**manifest.made_with, **made})

    assert manifest.made_with["pinned"] == "yes"
    assert list(differences(manifest, elsewhere(processor="Z80"))) == []
    free = elsewhere(pinned="no")
    (found,) = differences(free, elsewhere(pinned="no", processor="Z80"))
    assert found.endswith(", now Z80")


@pytest.mark.parametrize(
    ("changes", "subject"),
    [
        ({"seeds": [0, 1, 2, 3]}, "seeds was [3, 1], now [0, 1, 2, 3]"),
        ({"scenario": "other"}, "scenario"),
        ({"sets": {}}, "sets"),
        ({"sweep": {SPEED: [0.2, 0.1]}}, "sweep"),
        ({"traces": False}, "traces"),
        ({"plugins": {}}, "plugin"),
        ({"variants": []}, "the scenario's contents"),
        ({"made_with": {"numpy": "1.0"}}, "numpy"),
        ({"made_with": {"code": "1.0"}}, "swarmd's code"),
        ({"made_with": {"simd": "1.0"}}, "instructions for numpy"),
        ({"made_with": {"libm": "0"}}, "the C library's mathematical functions"),
        ({"made_with": {"libc": "glibc 2.1"}}, ", now glibc 2.1"),
        ({"made_with": {"functions": "0"}}, "functions of numpy"),
        ({"made_with": {"pinned": "no"}}, "pinned"),
        ({"made_with": {"new": "1.0"}}, "new was unknown, now 1.0"),
    ],
)
def test_differences_are_reported(
    manifest: Manifest, changes: dict[str, Any], subject: str
) -> None:
    if "made_with" in changes:
        changes = {"made_with": {**manifest.made_with, **changes["made_with"]}}
    (found,) = differences(manifest, msgspec.structs.replace(manifest, **changes))
    assert subject in found


def test_the_likeliest_cause_of_other_results_comes_first(manifest: Manifest) -> None:
    changed = dict.fromkeys(("blas", "libm", "machine", "mujoco", "code"), "x")
    new = msgspec.structs.replace(manifest, made_with={**manifest.made_with, **changed}, plugins={})
    found = [text.split()[0] for text in differences(manifest, new)]
    assert found == ["plugin", "swarmd's", "the", "mujoco", "blas", "machine"]


def test_what_an_older_manifest_does_not_tell_is_unknown(manifest: Manifest) -> None:
    told = {name: text for name, text in manifest.made_with.items() if name != "libm"}
    old = msgspec.structs.replace(manifest, made_with=told)
    (found,) = differences(old, manifest)
    assert found == f"libm was unknown, now {manifest.made_with['libm']}"


@pytest.mark.parametrize("value", [float("inf"), float("nan"), {1, 2}, object()])
def test_what_json_has_not_is_refused(value: object) -> None:
    with pytest.raises(SwarmError, match="JSON"):
        plain({"x": value})
