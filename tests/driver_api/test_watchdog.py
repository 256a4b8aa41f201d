"""When a watchdog says zero, decided with time handed in; its processes: tests/faults."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Mapping
from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError, DriverError
from swarmd.core.finding import Finding
from swarmd.core.values import ZERO, Twist, Value
from swarmd.daemon.driver import make_driver
from swarmd.driver_api.driver import Sink
from swarmd.driver_api.watchdog import ZERO_PERIOD, WatchdogTimer, watchdog_name
from swarmd.driver_api.watchdog_client import WatchedDriver
from swarmd.settings.driver_options import (
    IDLE_ZEROS_PERIOD,
    IdleOutputFilter,
    base_options,
    effective_command_timeout,
)
from swarmd.settings.settings import DaemonSettings, load_daemon_settings
from swarmd.testing.driver_contract import CollectingSink


def sending(timer: WatchdogTimer, *times: float) -> list[bool]:
    return [timer.is_sending(time) for time in times]


def fed(until: float = 0.0) -> WatchdogTimer:
    timer = WatchdogTimer()
    timer.tick(until)
    return timer


def test_begins_after_exactly_0_4_s_of_silence() -> None:
    assert sending(fed(), 0.0, 0.1, 0.3999999, 0.4, 0.5) == [False, False, False, True, True]
    assert sending(fed(9.0), 9.3999999, 9.4) == [False, True]


@pytest.mark.parametrize("period", [0.05, 0.39])
def test_sends_nothing_as_long_as_the_daemon_ticks_however_late(period: float) -> None:
    timer = WatchdogTimer()
    for tick in range(round(60.0 / period)):
        timer.tick(period * tick)
        assert not any(sending(timer, *(period * (tick + part / 8) for part in range(8))))


def test_sends_for_2_s_although_the_daemon_is_back_at_once() -> None:
    timer = fed()
    assert timer.is_sending(0.4)
    for i in range(41, 240):
        timer.tick(0.01 * i)
        assert timer.is_sending(0.01 * i)
    timer.tick(2.4)
    assert not timer.is_sending(2.4)


def test_sends_until_the_daemon_is_back_however_long_that_takes() -> None:
    timer = fed()
    assert all(sending(timer, 0.4, 2.4, 10.0, 3600.0))
    assert not timer.is_done(3600.0)
    timer.tick(3600.05)
    assert not timer.is_sending(3600.05)


def test_a_second_silence_is_as_good_as_the_first() -> None:
    timer = fed()
    timer.is_sending(0.4)
    timer.tick(3.0)
    assert sending(timer, 3.0, 3.25, 3.5, 5.25) == [False, False, True, True]
    timer.tick(5.25)
    assert sending(timer, 5.375, 5.5) == [True, False]


def test_end_of_file_is_acted_on_at_once_and_lasts_until_relieved() -> None:
    timer = fed()
    timer.close(0.01)
    assert all(sending(timer, 0.01, 1.0, 100.0))
    assert not timer.is_done(100.0)
    timer.relieve()
    assert timer.is_done(100.0)
    early = fed()
    early.close(1.0)
    early.relieve()
    assert sending(early, 1.0, 2.9) == [True, True]
    assert not early.is_done(2.9)
    assert early.is_done(3.0)
    assert not early.is_sending(3.0)


def test_before_the_first_tick_it_never_sends() -> None:
    timer = WatchdogTimer()
    assert sending(timer, 0.0, 10.0) == [False, False]
    timer.close(11.0)
    assert not timer.is_sending(11.0)
    assert timer.is_done(11.0)


def test_relieved_of_a_frozen_daemon_it_ends_its_zeros_but_watches_on() -> None:
    timer = fed()
    assert timer.is_sending(0.4)
    timer.relieve()
    assert sending(timer, 2.3, 2.5, 9.0) == [True, False, False]
    assert not timer.is_done(9.0)
    timer.tick(9.1)  # the thaw
    assert sending(timer, 9.2, 9.5) == [False, True]


def test_a_relieved_daemon_that_is_killed_while_frozen_causes_no_zeros() -> None:
    timer = fed()
    timer.is_sending(0.4)
    timer.relieve()
    timer.is_sending(2.5)
    timer.close(5.0)
    assert not timer.is_sending(5.0)
    assert timer.is_done(5.0)


def test_wakes_when_the_silence_is_long_enough_and_then_every_tick() -> None:
    timer = fed(1.0)
    assert timer.wait(1.1) == pytest.approx(0.3)
    assert timer.wait(2.0) == 0.0
    timer.is_sending(2.0)
    assert timer.wait(2.0) == ZERO_PERIOD


def test_names_differ_by_robot_and_swarm_and_fit_into_a_socket_address() -> None:
    names = {watchdog_name(swarm, robot) for swarm in ("a", "b" * 63) for robot in ("r", "s" * 63)}
    assert len(names) == 4
    assert all(len(name) < 100 for name in names)


# Idle output


def test_silent_lets_the_first_zeros_through_and_then_none() -> None:
    idle = IdleOutputFilter("silent")
    told = [idle.allows(ZERO, True, 0.125 * i) for i in range(100)]
    assert told == [0.125 * i < IDLE_ZEROS_PERIOD for i in range(100)]
    usual = IdleOutputFilter("zeros")
    assert all(usual.allows(ZERO, True, 0.05 * i) for i in range(200))


def test_only_an_idle_robot_is_silent() -> None:
    idle = IdleOutputFilter("silent")
    assert all(idle.allows(ZERO, False, 0.1 * i) for i in range(100)), "stopped, estopped, held"
    assert all(idle.allows(Twist(0.1), False, 10.0 + 0.1 * i) for i in range(100))
    assert idle.allows(ZERO, True, 20.0), "its zeros begin when it becomes idle"
    assert not idle.allows(ZERO, True, 21.0)
    assert idle.allows(Twist(0.1), True, 21.0), "what moves is never withheld"


# What the files say


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"command_timeout": "never"}, "here: command_timeout is 'never'; expected "),
        (
            {"command_timeout": 5.0},
            "here: command_timeout is 5.0; expected a number of at least 0.1 and up to 2",
        ),
        ({"command_timeout": True}, "here: command_timeout is True; expected "),
        ({"idle_output": "off"}, "here: idle_output is 'off'; expected "),
        ({"command_timeout": "none", "idle_output": "silent"}, "here: idle_output is silent"),
    ],
)
def test_refuses(options: Mapping[str, Value], fault: str) -> None:
    with pytest.raises(ConfigError) as caught:
        base_options(options, "here")
    assert str(caught.value).startswith(fault)
    assert "\n" not in str(caught.value)


class Bare:
    """A driver that knows nothing of watchdogs."""

    def __init__(self, *, is_simulated: bool, **_: object) -> None:
        self.is_simulated = is_simulated

    async def run(self, sink: Sink) -> None: ...

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None: ...

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        return ()


class Own(Bare):
    """A driver that brings a process of its own."""

    def zero_sender(self) -> None:
        return None


def settings(folder: Path, **options: Value) -> DaemonSettings:
    values = {"id": "r", "state_dir": str(folder), "driver_options": options}
    return load_daemon_settings(None, values)


def made(
    monkeypatch: pytest.MonkeyPatch, folder: Path, kind: type[Bare], real: bool, **options: Value
) -> object:
    def factory(**given: object) -> Bare:
        assert given["options"] == {}, "the common keys are none of the driver's"
        return kind(is_simulated=not real)

    monkeypatch.setattr("swarmd.daemon.driver.load_driver", lambda name: factory)
    return make_driver(settings(folder, **options))


def test_an_unconfigured_real_robot_has_no_command_timeout() -> None:
    assert effective_command_timeout(base_options({}, ""), Bare(is_simulated=False)) == "none"
    assert effective_command_timeout(base_options({}, ""), Bare(is_simulated=True)) == "base"


def test_a_driver_without_a_watchdog_is_refused_where_one_is_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for options in ({}, {"command_timeout": "none"}):
        with pytest.raises(ConfigError, match="command_timeout"):
            made(monkeypatch, tmp_path, Bare, True, **options)
    assert isinstance(made(monkeypatch, tmp_path, Bare, True, command_timeout="base"), Bare)
    assert isinstance(made(monkeypatch, tmp_path, Bare, True, command_timeout=0.5), Bare)
    assert isinstance(made(monkeypatch, tmp_path, Own, True, command_timeout="none"), Own)


def test_silent_idle_output_needs_a_command_timeout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ConfigError, match="idle_output"):
        made(monkeypatch, tmp_path, Own, True, idle_output="silent")
    made(monkeypatch, tmp_path, Own, True, idle_output="silent", command_timeout=0.25)


def test_the_simulated_driver_has_a_watchdog_only_if_configured(tmp_path: Path) -> None:
    assert isinstance(make_driver(settings(tmp_path, command_timeout="none")), WatchedDriver)
    assert not isinstance(make_driver(settings(tmp_path)), WatchedDriver)


def test_a_machine_without_room_for_a_watchdog_is_no_crash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*args: object, **options: object) -> None:
        raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")

    driver = make_driver(settings(tmp_path, command_timeout="none"))
    monkeypatch.setattr("swarmd.driver_api.watchdog_client.subprocess.Popen", full)
    with pytest.raises(DriverError, match="Resource temporarily unavailable"):
        asyncio.run(driver.run(CollectingSink()))
    (finding,) = [one for one in asyncio.run(driver.check(0.1)) if one.subject == "watchdog"]
    assert not finding.is_well
