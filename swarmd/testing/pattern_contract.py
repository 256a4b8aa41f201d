"""What every pattern must hold to, as tests.

In your own tests, run by pytest::

    from swarmd.testing.pattern_contract import PatternContract

    class TestSwirl(PatternContract):
        pattern = Swirl
        platforms = ("burger", "waffle_pi")   # default: all that come with swarmd
        params = {"radius": 1.0}              # default: the pattern's own
"""

from __future__ import annotations

import math
import random
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any, ClassVar

import msgspec
import numpy as np

from swarmd.core.codec import encode_value
from swarmd.core.values import (
    Inputs,
    Message,
    Neighbor,
    Odometry,
    Outputs,
    Platform,
    Pose,
    Scan,
    Twist,
    Value,
)
from swarmd.kit.behavior import Pattern
from swarmd.kit.factory import assemble, full_layers
from swarmd.kit.params import build, schema
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.settings.settings import load_platform, platform_names
from swarmd.testing.no_side_effects import closed
from swarmd.testing.scans import busy_scans, mirrored, odd_scans, read_only, reordered

_NAME = "pattern under contract"
# Sums over the rays in another order differ by rounding.
_TOLERANCE = 1e-6
# Wishes beyond the platform's limits are clipped; the paper's law asks for 1.57 times them.
_SANE = 2.0
# A step may take this share of the time between two; a robot's computer is some times slower.
_SHARE = 0.1
# What may be said on a channel, by its type.
_WORDS: Mapping[type, tuple[Value, ...]] = {
    bool: (True, False),
    int: (1, 1, 0, -(2**63), 2**63 - 1),
    float: (0.5, 0.5, math.nan, math.inf, -1e300),
    str: ("a", "a", "", "\x00", "a" * 900),
    bytes: (b"a", b"", b"\xff" * 900),
    list: ([], [1, "a", None], [[[]]]),
    dict: ({}, {"a": 1}, {"": {"": None}}),
}
_REPORTED = (bool, int, float, str, np.generic)


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """One pattern on one platform; a combined one finds parts in `plugin_dir` too."""

    kind: type[Pattern[Any]]
    platform: Platform
    params: Mapping[str, Value]
    plugin_dir: Path | None = None

    def make(self, seed: int = 0) -> Pattern[Any]:
        """A fresh object; its generator has this seed."""
        return assemble(
            _NAME,
            (("test", self.params),),
            find=self._find,
            robot="robot-1",
            platform=self.platform,
            rng=np.random.default_rng(seed),
        ).pattern

    def run(self, scans: Sequence[Scan | None], *, seed: int = 0) -> list[Outputs]:
        """The outputs of a fresh object, two steps a scan, with neighbours that talk."""
        pattern = self.make(seed)
        return [pattern.step(inputs) for inputs in self.story(pattern, scans)]

    def story(self, pattern: Pattern[Any], scans: Sequence[Scan | None]) -> Iterator[Inputs]:
        """Inputs for these scans: 10 Hz, everything sensed that the pattern needs."""
        readings = {
            need.removeprefix("reading:"): 1.0
            for need in pattern.needs
            if need.startswith("reading:")
        }
        for index in range(2 * len(scans)):
            scan = scans[index // 2]
            yield Inputs(
                now=100.0 + 0.1 * index,
                dt=0.1 if index else 0.0,
                scan=scan,
                is_new_scan=index % 2 == 0 and scan is not None,
                odometry=Odometry(0.1 * index, Pose(), Twist()),
                neighbors=(Neighbor("robot-2", 0.1, 1.0, 0.5, 0.2), Neighbor("robot-3", 0.2)),
                messages=_chatter(pattern, index),
                readings=readings,
            )

    def _find(self, name: str) -> type[Pattern[Any]]:
        if name == _NAME:
            return self.kind
        return _finder(self.plugin_dir)(name)


_platform = cache(load_platform)  # asked for by each test of each pattern


class PatternContract:
    """Subclass it in a test module, set `pattern`, and pytest runs it for every platform."""

    pattern: ClassVar[type[Pattern[Any]]]
    params: ClassVar[Mapping[str, Value]] = {}
    platforms: ClassVar[Sequence[str]] = ()
    plugin_dir: ClassVar[Path | None] = None
    seconds: ClassVar[float] = 20.0

    def setup_method(self) -> None:
        """Let a test use `seconds` of processor time; a pattern that loops for ever ends there."""

        def on_alarm(number: int, frame: FrameType | None) -> None:
            raise AssertionError(f"not done after {self.seconds:g} s of processor time")

        signal.signal(signal.SIGVTALRM, on_alarm)
        signal.setitimer(signal.ITIMER_VIRTUAL, self.seconds)

    def teardown_method(self) -> None:
        """Its time no longer runs."""
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)

    @classmethod
    def pytest_generate_tests(cls, metafunc: Any) -> None:
        """Run each test for each platform."""
        if "subject" in metafunc.fixturenames:
            names = cls.platforms or platform_names()
            metafunc.parametrize("subject", [cls.subject(name) for name in names], ids=names)

    @classmethod
    def subject(cls, platform: str) -> Subject:
        """The pattern on a platform that provides all that it needs."""
        known = _platform(platform)
        provides = known.provides | cls.pattern.needs
        return Subject(cls.pattern, replace(known, provides=provides), cls.params, cls.plugin_dir)

    def test_defaults_are_valid(self, subject: Subject) -> None:
        """With what derives from the platform, every parameter is within its own bounds."""
        layers = full_layers(subject.kind, subject.platform, (("test", subject.params),))
        build(subject.kind.params_type, layers)
        assert 1.0 <= subject.kind.rate <= 50.0, "rate is outside 1 to 50 Hz"

    def test_parameters_are_described(self, subject: Subject) -> None:
        """Every parameter has a meaning; every number has bounds."""
        for spec in schema(subject.kind.params_type):
            assert spec.description, f"{spec.name} has no description"
            is_number = spec.type in ("int", "float")
            assert not is_number or None not in (spec.ge, spec.le), f"{spec.name} has no bounds"

    def test_odd_scans_give_sane_wishes(self, subject: Subject) -> None:
        """Whatever the lidar gives, alone or after other scans, the wish is finite and bounded."""
        odd = odd_scans(subject.platform)
        for name, scan in odd.items():
            for outputs in subject.run([scan] * 3):
                _check_sane(outputs, subject.platform, name)
        for outputs in subject.run([*odd.values(), *busy_scans(subject.platform, 5), None]):
            _check_sane(outputs, subject.platform, "a mix of scans")

    def test_outputs_are_plain(self, subject: Subject) -> None:
        """Messages go to declared channels and fit the wire; reports are scalars."""
        channels = subject.make().channels
        for outputs in subject.run(busy_scans(subject.platform, 40)):
            unknown = set(outputs.messages) - set(channels)
            assert not unknown, f"says something on {unknown}, which is not in channels"
            for value in outputs.messages.values():
                encode_value(value)
            for key, value in outputs.report.items():
                assert isinstance(value, _REPORTED), f"report {key} is a {type(value).__name__}"

    def test_runs_without_a_scan(self, subject: Subject) -> None:
        """Before the first scan it neither raises nor forgets to answer."""
        for outputs in subject.run([None] * 20):
            assert isinstance(outputs, Outputs), f"a step gave a {type(outputs).__name__}"

    def test_the_same_seed_gives_the_same_run(self, subject: Subject) -> None:
        """Chance comes from `context.rng` alone, and nothing else changes a run."""
        scans = busy_scans(subject.platform, 60)
        before = _global_chance()
        first, second = (subject.run(scans, seed=7) for _ in range(2))
        is_same = [_plain(o) for o in first] == [_plain(o) for o in second]
        assert is_same, "two runs with one seed differ"
        assert _global_chance() == before, "uses a random generator other than context.rng"

    def test_inputs_are_left_alone(self, subject: Subject) -> None:
        """A step writes to nothing that it was given."""
        scans = busy_scans(subject.platform, 10)
        with_copies = subject.run([read_only(scan) for scan in scans])
        is_same = [_plain(o) for o in with_copies] == [_plain(o) for o in subject.run(scans)]
        assert is_same, "the run differs where the scans can be written to"

    def test_touches_nothing_outside(self, subject: Subject) -> None:
        """No file, no socket, no process, no wall clock, no sleep, no word on the console."""
        pattern = subject.make()
        story = list(subject.story(pattern, busy_scans(subject.platform, 20)))
        with closed(subject.kind.__module__):
            for inputs in story:
                pattern.step(inputs)

    def test_steps_take_little_time(self, subject: Subject) -> None:
        """Half of the steps take at most a tenth of the time between two, on this machine."""
        pattern = subject.make()
        spent = []
        for inputs in subject.story(pattern, busy_scans(subject.platform, 20)):
            began = time.thread_time()
            pattern.step(inputs)
            spent.append(time.thread_time() - began)
        median, limit = sorted(spent)[len(spent) // 2], _SHARE / subject.kind.rate
        assert median <= limit, f"a step takes {1e3 * median:.1f} ms; at most {1e3 * limit:.1f}"

    def test_mirrored_scans_give_mirrored_wishes(self, subject: Subject) -> None:
        """Left and right are treated alike, if the pattern claims so with `is_symmetric`."""
        scans = busy_scans(subject.platform, 30) if subject.kind.is_symmetric else []
        # Where nothing is seen, chance may decide, the same chance on both sides.
        for scan in (scan for scan in scans if np.isfinite(scan.ranges).any()):
            here = subject.run([scan] * 3)[-1].twist
            there = subject.run([mirrored(scan)] * 3)[-1].twist
            assert (here is None) == (there is None), "a wish on one side only"
            if here is not None and there is not None:
                swapped = Twist(there.linear, -there.angular, -there.lateral)
                _check_close(here, swapped, f"mirrored scan {scan.seq}")

    def test_the_order_of_rays_means_nothing(self, subject: Subject) -> None:
        """Rays may start anywhere and come in any order; their bearings count."""
        rng = np.random.default_rng(1)
        for scan in busy_scans(subject.platform, 20):
            here = subject.run([scan] * 3)[-1].twist
            there = subject.run([reordered(scan, rng)] * 3)[-1].twist
            _check_close(here or Twist(), there or Twist(), f"reordered scan {scan.seq}")

    def test_parameters_can_be_set_while_it_runs(self, subject: Subject) -> None:
        """`update` between two steps neither raises nor stops it."""
        pattern = subject.make()
        story = list(subject.story(pattern, busy_scans(subject.platform, 10)))
        for inputs in story[:10]:
            pattern.step(inputs)
        pattern.update(pattern.params)
        for inputs in story[10:]:
            _check_sane(pattern.step(inputs), subject.platform, "a step after update")

    def test_survives_a_jump_of_time(self, subject: Subject) -> None:
        """A step an hour after the last one, as after a suspend, is a step like any other."""
        pattern = subject.make()
        for inputs in subject.story(pattern, busy_scans(subject.platform, 4)):
            pattern.step(inputs)
            later = msgspec.structs.replace(inputs, now=inputs.now + 3600.0, dt=3600.0)
        _check_sane(pattern.step(later), subject.platform, "a step after an hour")


@cache
def _finder(plugin_dir: Path | None) -> PatternLoader:
    """Finds the parts of combined patterns, by the names that there are at the first look."""
    found = pattern_names(plugin_dir)
    return PatternLoader({name: (origin.value, origin.is_file) for name, origin in found.items()})


def _chatter(pattern: Pattern[Any], index: int) -> tuple[Message, ...]:
    """What neighbours might say now and then: of each channel's type, sensible or odd.

    The host drops what is not of the channel's type before a pattern sees it.
    """
    if index % 5:
        return ()
    said = [
        Message(f"robot-{number + 2}", channel, value, 0.05)
        for channel, kind in pattern.channels.items()
        for number, value in enumerate(_WORDS.get(kind, ()))
    ]
    return (*said, Message("robot-2", "no-such-channel", 1, 0.0))


def _check_sane(outputs: Outputs, platform: Platform, what: str) -> None:
    twist = outputs.twist
    if twist is None:
        return
    limits = platform.limits
    assert twist.is_finite, f"{what}: the wish is {twist}"
    assert abs(twist.linear) <= _SANE * limits.linear, f"{what}: the wish is {twist}"
    assert abs(twist.angular) <= _SANE * limits.angular, f"{what}: the wish is {twist}"
    assert abs(twist.lateral) <= _SANE * limits.lateral, f"{what}: the wish is {twist}"


def _check_close(here: Twist, there: Twist, what: str) -> None:
    pairs = (
        (here.linear, there.linear),
        (here.angular, there.angular),
        (here.lateral, there.lateral),
    )
    is_close = all(math.isclose(a, b, rel_tol=0.0, abs_tol=_TOLERANCE) for a, b in pairs)
    assert is_close, f"{what}: {here} and {there}"


def _plain(outputs: Outputs) -> tuple[object, ...]:
    """What can be compared: reports and messages are mappings of any kind."""
    return outputs.twist, dict(outputs.messages), dict(outputs.report), outputs.done


def _global_chance() -> tuple[object, ...]:
    """The state of the generators that all code shares."""
    return random.getstate(), repr(np.random.get_state(legacy=False))
