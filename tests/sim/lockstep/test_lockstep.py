"""A swarm in lockstep: the same bits for a seed, and what events do to robots."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import SwarmError
from swarmd.sim.lockstep.lockstep import BASE_TIMEOUT, Lockstep, simulate_run
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace
from swarmd.sim.world.detector import ObjectsAround
from swarmd.sim.world.world import World

RANDOM = {
    "duration": 3.0,
    "arena": {"size": [6.0, 6.0], "boxes": [{"name": "crate", "at": [0.0, 0.0], "size": [0.4, 0.4],
                                             "mass": 1.0}]},
    "groups": {
        "slow": {"count": 2, "prefix": "s", "pattern": "random_walk"},
        "voters": {"platform": "burger", "count": 3, "prefix": "v", "pattern": "majority_rule"},
    },
    "start": {"layout": "random", "clearance": 0.1},
    "radio": {"loss": 0.2, "delay": 0.02, "jitter": 0.01},
    "lidar_visibility": "real",
    "accepts_unseen": ["waffle_pi"],
    "accepts_faster": ["waffle_pi"],
}  # fmt: skip


def scenario(**changes: Any) -> Scenario:
    """Three Waffle Pis that drive, each on its own side of a large room; ideal."""
    data: dict[str, Any] = {
        "duration": 4.0,
        "realism": "ideal",
        "arena": {"size": [30.0, 30.0]},
        "groups": {"all": {"count": 3, "prefix": "r", "pattern": "drive"}},
        "start": {"layout": "row", "spacing": 5.0},
    }
    return scenario_of({**data, **changes})


def events(*items: dict[str, Any]) -> Scenario:
    return scenario(events=list(items))


def speeds(trace: Trace) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(T - 1, n) m/s."""
    step = np.diff(trace.pose[..., :2], axis=0)
    along: np.ndarray[Any, np.dtype[np.float64]] = np.hypot(step[..., 0], step[..., 1])
    return along / np.diff(trace.t)[:, None]


def at(trace: Trace, time: float) -> int:
    return int(np.argmin(np.abs(trace.t - time)))


def digest(trace: Trace) -> str:
    """Of every array."""
    whole = hashlib.sha256()
    names = "t pose safe requested contact_t contact_speed decided evaded"
    for name in names.split():
        whole.update(np.ascontiguousarray(getattr(trace, name)).tobytes())
    for name in sorted(trace.report):
        whole.update(trace.report[name].tobytes())
    return whole.hexdigest()


def test_the_same_seed_gives_the_same_bits_and_another_seed_others() -> None:
    runs = [digest(simulate_run(scenario_of(RANDOM), seed)) for seed in (4, 4, 5)]
    in_pieces = Lockstep(scenario_of(RANDOM), 4)
    for _ in range(30):
        in_pieces.advance(0.1)
    assert runs[0] == runs[1] == digest(in_pieces.trace())
    assert runs[0] != runs[2]


@pytest.mark.integration
def test_the_bits_do_not_depend_on_the_process() -> None:
    script = (
        "import json, sys; from pathlib import Path; sys.path.insert(0, sys.argv[1])\n"
        "from test_lockstep import RANDOM, digest, scenario_of, simulate_run\n"
        "print(digest(simulate_run(scenario_of(RANDOM), 4)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(Path(__file__).parent)],
        env={**os.environ, "PYTHONHASHSEED": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == digest(simulate_run(scenario_of(RANDOM), 4))


def test_robots_drive_at_their_speed_and_report_it() -> None:
    trace = simulate_run(scenario(), 0)
    assert trace.t[0] == 0.0
    assert trace.t[-1] == pytest.approx(4.0)
    assert np.diff(trace.t) == pytest.approx(0.1)
    np.testing.assert_allclose(speeds(trace)[20:], 0.13, atol=0.135)
    assert trace.state is not None
    assert (trace.state[1:] == "running").all()
    assert trace.decided is not None
    assert trace.decided.sum() == pytest.approx(3 * 4.0 * 5.0, abs=3)
    assert trace.meta["thresholds"] == {"waffle_pi": 0.5}


def test_stop_stops_the_named_robot_alone_and_run_starts_it_again() -> None:
    trace = simulate_run(
        events({"at": 1.5, "stop": ["r-02"]}, {"at": 3.0, "run": "drive", "targets": ["r-02"]}), 0
    )
    moving = speeds(trace)
    still = slice(at(trace, 2.0), at(trace, 2.9))
    assert (moving[still, 1] < 1e-6).all()
    assert (moving[still][:, [0, 2]] > 0.1).all()
    assert moving[-1, 1] > 0.1
    assert trace.reason is not None
    assert trace.reason[at(trace, 2.5), 1] == "operator"


def test_a_leaving_robot_stops_at_once_a_killed_one_by_its_timeout() -> None:
    trace = simulate_run(events({"at": 2.0, "leave": ["r-01"]}, {"at": 2.0, "kill": ["r-02"]}), 0)
    moving = speeds(trace)
    assert trace.present is not None
    np.testing.assert_array_equal(trace.present[-1], [False, False, True])
    assert moving[at(trace, 2.3), 0] < 1e-6
    assert moving[at(trace, 2.0 + BASE_TIMEOUT - 0.15), 1] > 0.1
    assert moving[at(trace, 2.0 + BASE_TIMEOUT + 0.3), 1] < 1e-6
    assert moving[-1, 2] > 0.1


def test_a_removed_robot_is_absent_invisible_and_untouched() -> None:
    """Two drive at each other; the one that is taken away leaves the other's way free."""
    trace = simulate_run(
        scenario(
            duration=12.0,
            groups={
                "a": {
                    "robots": ["r-1", "r-2"],
                    "pattern": "drive",
                    "start": {"layout": "list", "poses": [[-1.0, 0.0, 0.0], [1.0, 0.0, 180.0]]},
                }
            },
            radio={"range_and_bearing": True},
            events=[{"at": 1.0, "remove": "r-2"}],
        ),
        0,
    )
    assert trace.present is not None
    assert trace.present[at(trace, 0.9)].all()
    assert not trace.present[at(trace, 1.1) :, 1].any()
    assert np.isfinite(trace.pose[at(trace, 0.9)]).all()
    assert np.isnan(trace.pose[at(trace, 1.1) :, 1]).all()
    assert trace.pose[-1, 0, 0] > 1.0
    assert len(trace.contact_t) == 0
    assert trace.gap is not None
    assert np.isnan(trace.gap[at(trace, 3.0) :, 0]).all()
    numbers = measure(trace)
    assert (numbers["minimum_gap"] or 0.0) > 1.0
    assert (numbers["clearance"] or 0.0) > 1.0


def test_a_robot_that_joins_later_waits_at_its_start_pose() -> None:
    joining = scenario(
        events=[{"at": 1.0, "join": ["r-01"]}, {"at": 2.0, "run": "drive", "targets": ["r-01"]}]
    )
    trace = simulate_run(joining, 0)
    assert trace.present is not None
    assert not trace.present[at(trace, 0.5), 0]
    assert trace.present[at(trace, 1.2), 0]
    np.testing.assert_array_equal(trace.pose[0, 0], trace.pose[at(trace, 1.9), 0])
    assert speeds(trace)[-1, 0] > 0.1


def test_a_halted_robot_hears_who_joined_meanwhile() -> None:
    """Its lidar sees no Waffle Pi: the finding is how it shows that it knows of one."""
    run = Lockstep(
        scenario_of(
            {
                "duration": 3.0,
                "groups": {
                    "a": {"platform": "burger", "count": 1, "prefix": "b"},
                    "z": {"platform": "waffle_pi", "count": 1, "prefix": "w"},
                },
                "start": {"layout": "row", "spacing": 2.0},
                "accepts_unseen": ["waffle_pi"],
                "accepts_faster": ["waffle_pi"],
                "events": [
                    {"at": 0.5, "fault": {"process": "frozen"}, "robots": ["b-01"], "for": 1.0},
                    {"at": 1.0, "join": ["w-01"]},
                ],
            }
        ),
        1,
    )

    def found() -> set[tuple[str, str]]:
        shell = run.shells[0]
        assert shell is not None
        return {(one.robot, one.kind) for one in shell.robot.status(run.world.time).peers}

    run.advance(0.4)
    assert found() == set()
    run.advance(1.6)
    assert ("w-01", "unseen") in found()


def test_parameters_of_a_run_and_of_param_reach_the_pattern() -> None:
    trace = simulate_run(events({"at": 2.0, "param": {"speed": 0.05}, "targets": ["r-01"]}), 0)
    late = speeds(trace)[at(trace, 3.0) :]
    np.testing.assert_allclose(late[:, 0], 0.05, atol=1e-3)
    assert (late[:, 1] > 0.1).all()


@pytest.mark.parametrize("end", [{"for": 1.0}, {"until": ["timeout:1"]}])
def test_a_run_ends_after_its_seconds_or_by_its_condition(end: dict[str, Any]) -> None:
    running = {"count": 3, "prefix": "r"}
    event = {"at": 0.5, "run": "drive", **end}
    trace = simulate_run(scenario(groups={"all": running}, events=[event]), 0)
    assert trace.reason is not None
    assert (speeds(trace)[at(trace, 1.2)] > 0.01).all()
    assert set(trace.reason[-1]) == {"finished"}
    assert (speeds(trace)[-1] < 1e-6).all()


def test_messages_pass_the_radio_alone() -> None:
    """Majority rule of five; a robot without neighbors keeps its opinion."""
    voters: dict[str, Any] = {
        "duration": 14.0,
        "groups": {"all": {"count": 5, "prefix": "r", "pattern": "majority_rule"}},
        "start": {"layout": "row", "spacing": 2.0},
    }
    together = simulate_run(scenario(**voters), 3)
    apart = simulate_run(scenario(**voters, radio={"neighborhood": "range", "range": 1.0}), 3)
    assert len(set(together.report["opinion"][-1])) == 1
    np.testing.assert_array_equal(apart.report["opinion"][-1], apart.report["opinion"][5])
    assert len(set(apart.report["opinion"][-1])) > 1


def faulty(folder: Path, *more: dict[str, Any]) -> Scenario:
    """One robot whose pattern always raises."""
    (folder / "faulty.py").write_text(
        "from swarmd.api import MovementPattern, Params, Twist\n"
        "class Faulty(MovementPattern[Params]):\n"
        "    params_type = Params\n"
        "    def drive(self, inputs):\n"
        "        raise RuntimeError('boom') if inputs.now else RuntimeError('at once')\n"
    )
    one = {"count": 1, "prefix": "r", "pattern": "faulty"}
    return scenario(groups={"all": one}, plugin_dir=str(folder), events=list(more))


def test_a_pattern_that_raises_is_restarted_and_then_quarantined(tmp_path: Path) -> None:
    trace = simulate_run(faulty(tmp_path), 0)
    assert trace.state is not None
    assert trace.state[-1, 0] == "faulted"
    assert (speeds(trace) < 1e-6).all()


def test_a_refusal_ends_the_run_with_the_robots_reason(tmp_path: Path) -> None:
    with pytest.raises(SwarmError, match=r"3 s run drive: r-01"):
        simulate_run(faulty(tmp_path, {"at": 3.0, "run": "drive"}), 0)


def test_a_robot_pushes_a_box_and_the_trace_holds_both() -> None:
    trace = simulate_run(
        scenario(
            duration=6.0,
            arena={
                "size": [20.0, 20.0],
                "boxes": [
                    {"name": "crate", "at": [0.9, 0.0], "size": [0.1, 0.1], "mass": 0.2},
                    {"name": "late", "size": [0.2, 0.2], "mass": 5.0},
                ],
            },
            groups={"all": {"count": 1, "prefix": "r", "pattern": "drive"}},
            platforms={"waffle_pi": {"protection": {"mode": "off"}}},
            events=[
                {"at": 2.0, "place": "late", "pose": [0.0, 3.0, 0.0]},
                {"at": 4.0, "remove": "late"},
            ],
        ),
        0,
    )
    assert trace.movable_boxes == ("crate", "late")
    assert trace.box_pose is not None
    assert trace.box_pose[-1, 0, 0] > 1.0
    assert set(trace.contact_pair[:, 1]) == {-2}
    is_there = np.isfinite(trace.box_pose[:, 1, 0])
    assert not is_there[at(trace, 1.9)]
    assert is_there[at(trace, 3.0)]
    assert not is_there[-1]


def test_readings_reach_the_pattern(tmp_path: Path) -> None:
    (tmp_path / "sniff.py").write_text(
        "from swarmd.api import ZERO, MovementPattern, Params\n"
        "class Sniff(MovementPattern[Params]):\n"
        "    params_type = Params\n"
        "    needs = frozenset({'scan', 'reading:light'})\n"
        "    light = 0.0\n"
        "    def drive(self, inputs):\n"
        "        self.light = inputs.readings.get('light', -1.0)\n"
        "        return ZERO\n"
        "    def report(self):\n"
        "        return {'light': self.light}\n"
    )
    trace = simulate_run(
        scenario(
            groups={"all": {"count": 2, "prefix": "r", "pattern": "sniff"}},
            plugin_dir=str(tmp_path),
            fields=[
                {"name": "light", "kind": "linear", "slope": 1.0, "base": 2.0, "direction_deg": 90}
            ],
        ),
        0,
    )
    np.testing.assert_allclose(trace.report["light"][-1], [-0.5, 4.5], atol=1e-6)


def test_a_pattern_that_needs_its_pose_gets_that_of_the_world(tmp_path: Path) -> None:
    (tmp_path / "where.py").write_text(
        "from swarmd.api import ZERO, MovementPattern, Params\n"
        "class Where(MovementPattern[Params]):\n"
        "    params_type = Params\n"
        "    needs = frozenset({'pose'})\n"
        "    at = (0.0, 0.0)\n"
        "    def drive(self, inputs):\n"
        "        self.at = inputs.pose.x, inputs.pose.y\n"
        "        return ZERO\n"
        "    def report(self):\n"
        "        return {'x': self.at[0], 'y': self.at[1]}\n"
    )
    (tmp_path / "placed.yaml").write_text("extends: burger\nprovides: [scan, odometry, pose]\n")
    group = {
        "count": 2,
        "prefix": "r",
        "pattern": "where",
        "platform": str(tmp_path / "placed.yaml"),
    }
    trace = simulate_run(scenario(groups={"all": group}, plugin_dir=str(tmp_path)), 0)
    for row, name in enumerate(("x", "y")):
        np.testing.assert_allclose(trace.report[name][-1], trace.pose[-1, :, row], atol=1e-6)


def test_detections_reach_a_pattern_that_needs_them(tmp_path: Path) -> None:
    (tmp_path / "look.py").write_text(
        "from swarmd.api import ZERO, MovementPattern, Params\n"
        "class Look(MovementPattern[Params]):\n"
        "    params_type = Params\n"
        "    needs = frozenset({'detections'})\n"
        "    seen = ()\n"
        "    def drive(self, inputs):\n"
        "        self.seen = inputs.detections\n"
        "        return ZERO\n"
        "    def report(self):\n"
        "        kinds = ' '.join(one.kind for one in self.seen)\n"
        "        return {'count': len(self.seen), 'kinds': kinds}\n"
    )
    (tmp_path / "eyed.yaml").write_text(
        "extends: burger\nsensors: {detections: [{at: [0, 0], field_of_view_deg: 360, range: 5}]}\n"
    )
    group = {"count": 2, "prefix": "r", "pattern": "look", "platform": str(tmp_path / "eyed.yaml")}
    trace = simulate_run(scenario(groups={"all": group}, plugin_dir=str(tmp_path)), 0)
    assert trace.report["count"][-1].tolist() == [1.0, 1.0]
    assert trace.words["kinds"][-1].tolist() == ["robot", "robot"]


def test_what_robots_recognise_is_computed_for_a_pattern_that_needs_it_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[int] = []
    objects_around = World.objects_around

    def look(world: World, row: int) -> ObjectsAround:
        asked.append(row)
        return objects_around(world, row)

    monkeypatch.setattr(World, "objects_around", look)
    walkers = {"count": 2, "platform": "turtlebot4", "pattern": "random_walk"}
    Lockstep(scenario(groups={"a": walkers}), 0).advance(1.0)
    assert not asked
    pushers = {**walkers, "pattern": "cooperative_transport"}
    Lockstep(scenario(groups={"a": walkers, "b": pushers}), 0).advance(1.0)
    assert set(asked) == {2, 3}


def test_a_ring_reaches_protection_and_patterns(tmp_path: Path) -> None:
    """A Jackal is blind within 0.8 m; its ring sees the wall there, and without it stands."""
    (tmp_path / "feel.py").write_text(
        "from swarmd.api import MovementPattern, Params, Twist\n"
        "class Feel(MovementPattern[Params]):\n"
        "    params_type = Params\n"
        "    needs = frozenset({'scan', 'ranges'})\n"
        "    nearest = 9.0\n"
        "    def drive(self, inputs):\n"
        "        self.nearest = float(inputs.ranges.ranges.min())\n"
        "        return Twist(0.2)\n"
        "    def report(self):\n"
        "        return {'nearest': self.nearest}\n"
    )
    (tmp_path / "felt.yaml").write_text(
        "extends: jackal\n"
        "provides: [scan, ranges, odometry]\n"
        "ranges: {bearings_deg: [-20, 0, 20, 180], offset: [0.25, 0], rate: 10, range_min: 0.05,\n"
        "  range_max: 2.0, zero: unknown, sweep: null, latency: 0.05}\n"
    )
    group = {"count": 1, "prefix": "r", "pattern": "feel", "platform": str(tmp_path / "felt.yaml")}
    trace = simulate_run(
        scenario(
            duration=10.0,
            arena={"size": [4, 4]},
            groups={"all": group},
            start={"layout": "list", "poses": [[0.0, 0.0, 0.0]]},
            plugin_dir=str(tmp_path),
        ),
        0,
    )
    assert trace.reason is not None
    assert set(trace.reason[at(trace, 1.0) : at(trace, 3.0)].ravel()) == {""}
    assert trace.report["nearest"][at(trace, 1.0), 0] == pytest.approx(1.75 - 0.2, abs=0.2)
    assert 0.1 < np.nanmin(trace.report["nearest"]) < 0.8
    assert len(trace.contact_pair) == 0


@pytest.mark.parametrize("realism", ["ideal", "realistic"])
def test_an_omnidirectional_base_brakes_sideways_before_a_wall(realism: str) -> None:
    group = {"count": 1, "prefix": "r", "pattern": "drive", "platform": "rosbot_xl",
             "parameters": {"speed": 0.0, "lateral": 0.8}}  # fmt: skip
    trace = simulate_run(
        scenario(
            duration=8.0,
            realism=realism,
            arena={"size": [4.0, 6.0]},
            groups={"all": group},
            start={"layout": "list", "poses": [[0.0, 0.0, 0.0]]},
        ),
        0,
    )
    assert trace.safe[:, 0, 2].max() > 0.5
    assert 1.8 < trace.pose[:, 0, 1].max() < 3.0 - 0.163
    assert len(trace.contact_pair) == 0


def test_repeated_scans_without_noise_do_not_count_as_frozen() -> None:
    abreast = {"layout": "row", "spacing": 1.5, "heading_deg": 90}
    trace = simulate_run(scenario(duration=6.0, start=abreast), 0)
    assert trace.reason is not None
    assert set(trace.reason[at(trace, 1.0) :].ravel()) == {""}
