"""The hash of what robots did, and the names of the rules that acted."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.avoided import Avoided, WayState
from swarmd.core.values import Twist
from swarmd.robot.protection.decision import Decision
from swarmd.sim.behaviour import hash_of, rules_of, rules_of_decision
from swarmd.sim.trace import WORD, Trace, load_trace
from tests.support.traces import trace_of


def two(**parts: Any) -> Trace:
    """Two robots at three instants, which decided."""
    pose = np.arange(18.0).reshape(3, 2, 3)
    shape = (3, 2)
    decided: dict[str, Any] = {
        "requested": 0.1 * pose,
        "safe": 0.05 * pose,
        "state": np.full(shape, "running", dtype=WORD),
        "reason": np.full(shape, "", dtype=WORD),
        "active": np.zeros(shape, dtype=bool),
        "recovering": np.zeros(shape, dtype=bool),
        "bound": np.full((*shape, 3), np.nan),
        "report": {"opinion": np.ones(shape)},
        "words": {"task": np.full(shape, "rest", dtype=WORD)},
        "meta": {"modes": {"burger": "barrier"}},
    }
    return trace_of(pose, **{**decided, **parts})


def test_the_hash_is_that_of_the_bytes_of_all_that_robots_did() -> None:
    trace = two()
    assert trace.requested is not None
    assert trace.state is not None
    assert trace.reason is not None
    parts = [trace.pose, trace.requested, trace.safe, trace.state, trace.reason]
    parts += [trace.report["opinion"], trace.words["task"]]
    whole = hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()
    assert hash_of(trace) == whole[:12]
    second = hashlib.sha256(b"".join(part[1:, 1].tobytes() for part in parts)).hexdigest()
    assert hash_of(trace, 8, robot=1, instants=np.array([1, 2])) == second[:8]


def test_a_file_keeps_the_hash(tmp_path: Path) -> None:
    two().save(tmp_path / "x.npz")
    assert hash_of(load_trace(tmp_path / "x.npz")) == hash_of(two())


@pytest.mark.parametrize("name", ["pose", "safe", "requested"])
def test_one_bit_of_motion_is_another_hash(name: str) -> None:
    trace = two()
    values = getattr(trace, name).copy()
    values[1, 1, 0] = np.nextafter(values[1, 1, 0], np.inf)
    assert hash_of(replace(trace, **{name: values})) != hash_of(trace)


def test_another_reason_report_or_box_is_another_hash() -> None:
    trace = two()
    reason = np.full((3, 2), "", dtype=WORD)
    reason[2, 0] = "protection"
    boxes = np.zeros((3, 1, 3))
    moved = boxes.copy()
    moved[2, 0, 1] = 1e-9
    changed = [
        replace(trace, reason=reason),
        replace(trace, report={"opinion": np.zeros((3, 2))}),
        replace(trace, box_pose=boxes),
        replace(trace, box_pose=moved),
    ]
    assert len({hash_of(one) for one in [trace, *changed]}) == 5


def entered(values: Any, place: Any, value: Any) -> Any:
    some = values.copy()
    some[place] = value
    return some


def test_rules_are_what_acted_at_some_instant() -> None:
    free = two()
    assert rules_of(free) == ()
    assert free.active is not None
    assert free.recovering is not None
    assert free.reason is not None
    assert free.state is not None
    assert free.bound is not None
    at = (1, 0)
    assert rules_of(replace(free, active=entered(free.active, at, True))) == ("barrier",)
    assert rules_of(replace(free, recovering=entered(free.recovering, at, True))) == ("recovery",)
    stands = replace(free, reason=entered(free.reason, at, "late_scan"))
    assert rules_of(stands) == ("late_scan",)
    # A robot that does not run stands for a reason that is no rule.
    assert rules_of(replace(stands, state=entered(free.state, at, "idle"))) == ()
    assert rules_of(replace(free, bound=entered(free.bound, at, (0.1, 0.2, 0.1)))) == ()
    assert rules_of(replace(free, bound=entered(free.bound, at, (0.1, 0.0, 0.1)))) == ("touching",)
    assert rules_of(trace_of(free.pose, contacts=[(0.1, 0, 1)])) == ("contact",)
    noted = {"modes": {"burger": "barrier"}, "rules": ["opening", "fence"]}
    active = entered(free.active, at, True)
    assert rules_of(replace(free, active=active, meta=noted)) == ("barrier", "fence", "opening")


DECISION = Decision(
    mode="barrier",
    requested=Twist(0.1),
    safe=Twist(0.1),
    reason=None,
    is_active=False,
    rows=(),
    min_gap=None,
    scan_age=None,
    scan_seq=-1,
)


@pytest.mark.parametrize(
    ("changes", "rules"),
    [
        ({}, []),
        ({"avoided": Avoided(0.1, 1.0)}, ["avoidance"]),
        ({"avoided": Avoided(0.1, 1.0, WayState.WAIT)}, ["opening"]),
        ({"is_bounded": True}, ["fence"]),
        ({"speed_share": 0.5, "is_bounded": True}, ["fence", "slowed"]),
    ],
)
def test_a_decision_tells_the_rules_that_no_array_has(
    changes: dict[str, Any], rules: list[str]
) -> None:
    values = {name: getattr(DECISION, name) for name in Decision.__struct_fields__}
    assert list(rules_of_decision(Decision(**{**values, **changes}))) == rules
