"""Metrics of protection, of runs whose decisions are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swarmd.sim.metrics import protection
from swarmd.sim.metrics.window import late
from tests.sim.metrics.runs import run

STILL = np.zeros((4, 2, 3))


def test_duty_counts_scans_with_a_decision() -> None:
    decided = np.array([[0, 0], [2, 1], [2, 1], [0, 2]])
    evaded = np.array([[0, 0], [2, 0], [0, 0], [0, 2]])
    trace = run(STILL, decided=decided, evaded=evaded, active=np.ones((4, 2), dtype=bool))
    assert protection.protection_duty(trace) == pytest.approx(4.0 / 8.0)
    assert protection.protection_duty(late(trace, 0.1)) == pytest.approx(2.0 / 5.0)
    duties = protection.protection_duties(trace)
    assert duties is not None
    np.testing.assert_allclose(duties, [np.nan, 2.0 / 3.0, 0.0, 1.0])


def test_duty_falls_back_to_instants() -> None:
    assert protection.protection_duty(run(STILL)) is None
    assert protection.protection_duties(run(STILL)) is None
    none = np.zeros((4, 2), dtype=np.int64)
    assert protection.protection_duty(run(STILL, decided=none, evaded=none)) is None
    active = np.zeros((4, 2), dtype=bool)
    active[0] = True
    trace = run(STILL, active=active)
    assert protection.protection_duty(trace) == 0.25
    state = np.full((4, 2), "running")
    state[2:] = "stopped"
    assert protection.protection_duty(replace(trace, state=state)) == 0.5
    duties = protection.protection_duties(replace(trace, state=state))
    assert duties is not None
    np.testing.assert_array_equal(duties, [1.0, 0.0, np.nan, np.nan])


def test_duty_counts_only_robots_that_are_present() -> None:
    present = np.ones((4, 2), dtype=bool)
    present[:, 1] = False
    trace = run(
        STILL,
        decided=np.full((4, 2), 10),
        evaded=np.array([[5, 10]] * 4),
        present=present,
    )
    assert protection.protection_duty(trace) == 0.5


@pytest.mark.parametrize(
    ("requested", "safe", "altered"),
    [
        ((0.5, 0.0, 0.0), (0.5, 0.0, 0.0), 0.0),
        ((0.5, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0),  # full speed ahead, stopped
        ((0.5, 0.0, 0.0), (-0.5, 0.0, 0.0), 2.0),  # turned round
        ((0.0, 0.0, 0.0), (0.3, 0.0, 0.4), 1.0),
        ((0.0, 1.0, 0.0), (0.0, 0.0, 0.0), np.hypot(0.254, 0.215) / 0.5),  # a Jackal's corner
    ],
)
def test_alteration_is_in_units_of_full_speed(
    requested: tuple[float, ...],
    safe: tuple[float, ...],
    altered: float,
) -> None:
    trace = run(STILL, requested=np.tile(requested, (4, 2, 1)), safe=np.tile(safe, (4, 2, 1)))
    assert protection.command_alteration(trace) == pytest.approx(altered)
    means = protection.mean_alterations(trace)
    assert means is not None
    np.testing.assert_allclose(means, np.full(4, altered))


def test_alteration_is_of_running_robots() -> None:
    requested = np.zeros((4, 2, 3))
    requested[:, 0, 0] = 0.5
    trace = run(STILL, requested=requested)
    assert protection.command_alteration(trace) == pytest.approx(0.5)
    state = np.array([["stopped", "running"]] * 4)
    assert protection.command_alteration(replace(trace, state=state)) == 0.0
    present = np.array([[True, False]] * 4)
    assert protection.command_alteration(replace(trace, present=present)) == pytest.approx(1.0)


def test_alteration_needs_requested_commands_and_limits() -> None:
    assert protection.command_alteration(run(STILL)) is None
    assert protection.command_alteration(run(STILL, requested=STILL, meta={})) is None
    assert protection.mean_alterations(run(STILL)) is None


def test_robots_whose_pattern_failed_are_counted_once_each() -> None:
    state = np.array([["running"] * 2, ["running"] * 2, ["faulted", "running"], ["idle", "idle"]])
    reason = np.array([["", ""], ["pattern_restarting", ""], ["pattern_quarantined", ""], ["", ""]])
    assert protection.failed_patterns(run(STILL, state=state, reason=reason)) == 1
    both = np.array([["", ""], ["", "pattern_restarting"], ["", ""], ["", ""]])
    assert protection.failed_patterns(run(STILL, state=state, reason=both)) == 2
    assert protection.failed_patterns(run(STILL)) is None


def test_recovery_is_counted_while_running() -> None:
    recovering = np.array([[True, True], [True, False], [True, False], [False, False]])
    state = np.array([["running"] * 2, ["running"] * 2, ["stopped", "running"], ["running"] * 2])
    trace = run(STILL, recovering=recovering, state=state)
    assert protection.recovery_share(trace) == pytest.approx(3.0 / 7.0)
    assert protection.recovery_share(run(STILL)) is None
    assert protection.recovery_share(replace(trace, state=np.full((4, 2), "idle"))) is None


def test_holds_are_counted_while_running() -> None:
    state = np.array([["running"] * 2, ["running"] * 2, ["stopped", "running"], ["running"] * 2])
    reason = np.array(
        [["stale_scan", ""], ["no_requested_command", ""], ["stale_scan", "no_scan"], ["", ""]]
    )
    trace = run(STILL, state=state, reason=reason)
    assert protection.hold_share(trace) == pytest.approx(2.0 / 7.0)
    assert protection.hold_share(run(STILL)) is None
    assert protection.hold_share(run(STILL, state=np.full((4, 2), "idle"), reason=reason)) is None


def test_travel_extent_is_small_for_robots_that_wander_to_and_fro() -> None:
    t = np.arange(0.0, 60.05, 0.1)
    poses = np.zeros((len(t), 3, 3))
    poses[:, 0, 0] = 0.5 * np.sin(t)  # to and fro: 1 m
    poses[:, 1, 0] = 0.1 * t  # 6 m
    requested = np.full((len(t), 3, 3), (0.2, 0.0, 0.0))
    requested[:, 2] = 0.0  # rests on purpose
    trace = replace(run(poses, requested=requested), t=t)
    assert protection.travel_extent(trace) == pytest.approx(3.5, abs=0.01)
    assert protection.travel_extent(replace(trace, requested=None)) is None
    assert protection.travel_extent(run(STILL, requested=STILL)) is None
