"""Tests that every pattern must pass.

In your own tests, run by pytest::

    from swarmd.testing.pattern_contract import PatternContract

    class TestSwirl(PatternContract):
        pattern = Swirl
        platforms = ("burger", "waffle_pi")   # default: all that come with swarmd
        params = {"radius": 1.0}              # default: the pattern's own
"""

from __future__ import annotations

import math
import pickle
import signal
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import FrameType, FunctionType, ModuleType
from typing import Any, ClassVar, NoReturn

import msgspec
import numpy as np
from msgspec import structs

from swarmd.core.codec import encode_value
from swarmd.core.values import (
    Detection,
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
from swarmd.pattern_host.executor import checked_outputs
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names, places_of
from swarmd.settings.settings import load_platform, platform_names
from swarmd.testing.no_side_effects import no_side_effects
from swarmd.testing.scans import busy_scans, mirrored, odd_scans, read_only, reordered

_NAME = "pattern under contract"
# A sum over the rays in another order differs by rounding.
_TOLERANCE = 1e-6
# Commands beyond the platform's limits are clipped; the law of a paper asks for 1.57 times these.
_MAX_LIMIT_RATIO = 2.0
# A step may take this share of its period; a robot's computer is several times slower.
_MAX_STEP_SHARE = 0.1
# Values that neighbours send on a channel, by its type.
_VALUES: Mapping[type, tuple[Value, ...]] = {
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
    """One pattern on one platform; a combined pattern also finds parts in `plugin_dir`."""

    kind: type[Pattern[Any]]
    platform: Platform
    params: Mapping[str, Value]
    plugin_dir: Path | None = None
    has_places: bool = True  # one of the neighbours has a place

    def make(self, seed: int = 0) -> Pattern[Any]:
        """A new pattern object whose random generator has this seed."""
        return assemble(
            _NAME,
            (("test", self.params),),
            find=self._find,
            robot="robot-1",
            platform=self.platform,
            rng=np.random.default_rng(seed),
        ).pattern

    def run(self, scans: Sequence[Scan | None], *, seed: int = 0) -> list[Outputs]:
        """The outputs of a new object: two steps for each scan, with messages of neighbours."""
        pattern = self.make(seed)
        return self.steps(pattern, self.story(pattern, scans))

    def steps(self, pattern: Pattern[Any], story: Iterable[Inputs]) -> list[Outputs]:
        """The outputs of the pattern for these inputs, as the pattern host passes the outputs on.

        AssertionError if a step makes a forbidden call; PluginError if outputs have a wrong type.
        """
        with no_side_effects(self.kind.__module__):
            return [checked_outputs(pattern.step(inputs), pattern.channels) for inputs in story]

    def story(self, pattern: Pattern[Any], scans: Sequence[Scan | None]) -> Iterator[Inputs]:
        """Inputs for these scans: 10 Hz, with every sensor that the pattern needs."""
        named = (need.partition("reading:")[2] for need in pattern.needs)
        readings = _Readings({name: 1.0 for name in named if name})
        for index in range(2 * len(scans)):
            scan = scans[index // 2]
            yield Inputs(
                now=100.0 + 0.1 * index,
                dt=0.1 if index else 0.0,
                scan=scan,
                is_new_scan=index % 2 == 0 and scan is not None,
                odometry=Odometry(0.1 * index, Pose(), Twist()),
                neighbors=_NEIGHBORS[0 if self.has_places else 1 :],
                messages=_messages(pattern, index),
                readings=readings,
                ranges=scan if "ranges" in pattern.needs else None,
                detections=_DETECTIONS if "detections" in pattern.needs else None,
                pose=Pose(0.01 * index) if "pose" in pattern.needs else None,
            )

    def _find(self, name: str) -> type[Pattern[Any]]:
        if name == _NAME:
            return self.kind
        return _loader(self.plugin_dir)(name)


_NEIGHBORS = (
    Neighbor("robot-2", 0.1, 1.0, 0.5, 0.2),
    Neighbor("robot-3", 0.2),
    Neighbor("robot-4", 0.2),
)
_DETECTIONS = Detection("robot", 0.5, 1.0, "robot-2"), Detection("box", -0.2)


class _Readings(dict[str, float]):
    """The readings that a pattern needs; the error for any other name gives the remedy."""

    def __missing__(self, name: str) -> NoReturn:
        raise KeyError(f"the reading {name!r} is not in `needs`; add 'reading:{name}' to it")


_platform = cache(load_platform)  # asked for by each test of each pattern


class PatternContract:
    """The contract of a pattern: tests for pytest, each on every platform.

    Subclass it in a test module, with the pattern's class as `pattern`.
    """

    pattern: ClassVar[type[Pattern[Any]]]
    params: ClassVar[Mapping[str, Value]] = {}
    platforms: ClassVar[Sequence[str]] = ()
    plugin_dir: ClassVar[Path | None] = None
    seconds: ClassVar[float] = 20.0

    def setup_method(self) -> None:
        """Limit a test to `seconds` of processor time, for patterns that loop for ever.

        Windows has no such alarm.
        """
        if not hasattr(signal, "setitimer"):
            return

        def on_alarm(number: int, frame: FrameType | None) -> None:
            raise TimeoutError(f"not done after {self.seconds:g} s of processor time")

        signal.signal(signal.SIGVTALRM, on_alarm)
        signal.setitimer(signal.ITIMER_VIRTUAL, self.seconds)

    def teardown_method(self) -> None:
        """Lift the limit."""
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)

    @classmethod
    def pytest_generate_tests(cls, metafunc: Any) -> None:
        """Run each test for each platform."""
        if "subject" in metafunc.fixturenames:
            names = cls.platforms or platform_names()
            metafunc.parametrize("subject", [cls.subject(name) for name in names], ids=names)

    @classmethod
    def subject(cls, platform: str) -> Subject:
        """The pattern on a platform that provides all its `needs`."""
        known = _platform(platform)
        provides = known.provides | cls.pattern.needs
        return Subject(cls.pattern, replace(known, provides=provides), cls.params, cls.plugin_dir)

    def test_defaults_are_valid(self, subject: Subject) -> None:
        """Every default, declared or derived from the platform, has its type and bounds."""
        layers = full_layers(subject.kind, subject.platform, (("test", subject.params),))
        build(subject.kind.params_type, layers)
        assert 1.0 <= subject.kind.rate <= 50.0, "rate is outside 1 to 50 Hz"

    def test_parameters_are_described(self, subject: Subject) -> None:
        """Every parameter has a meaning; every number has bounds."""
        params_type = subject.kind.params_type
        for spec in schema(params_type):
            name = f"{params_type.__name__}.{spec.name}"
            assert spec.description, f"{name} has no description"
            is_number = spec.type in ("int", "float")
            assert not is_number or None not in (spec.ge, spec.le), f"{name} has no bounds"

    def test_steps_give_outputs_and_nothing_else(self, subject: Subject) -> None:
        """Steps before and with scans give outputs of the declared types, and have no side effect.

        Messages go to declared channels and can be encoded; reports are scalars. A step uses no
        file, socket, process, clock or console, never sleeps, and takes chance from `context.rng`.
        """
        pattern = subject.make()
        for inputs in subject.story(pattern, [*[None] * 10, *busy_scans(subject.platform, 40)]):
            with no_side_effects(subject.kind.__module__):
                raw = pattern.step(inputs)
            outputs = checked_outputs(raw, pattern.channels)
            for key, shown in raw.report.items():  # the pattern host leaves out other types
                assert isinstance(shown, _REPORTED), f"report {key} is a {type(shown).__name__}"
            unknown = set(outputs.messages) - set(pattern.channels)
            assert not unknown, f"sends on {unknown}, which is not in channels"
            for value in outputs.messages.values():
                encode_value(value)

    def test_odd_scans_give_sane_commands(self, subject: Subject) -> None:
        """Commands are finite and bounded for each odd scan, alone and after other scans."""
        odd = odd_scans(subject.platform)
        for name, scan in odd.items():
            with _under(name):
                _check_sane(subject.run([scan] * 3), subject.platform)
        with _under("a mix of scans"):
            mix = [*odd.values(), *busy_scans(subject.platform, 5), None]
            _check_sane(subject.run(mix), subject.platform)

    def test_the_same_seed_gives_the_same_run(self, subject: Subject) -> None:
        """Only inputs and `context.rng` influence a run."""
        _check_repeatable(subject, busy_scans(subject.platform, 60))

    def test_memory_is_kept_in_self(self, subject: Subject) -> None:
        """A run changes no value of the module or of a class, which robots of a process share."""
        before = _shared_values(subject.kind)
        subject.run(busy_scans(subject.platform, 20))
        after = _shared_values(subject.kind)
        changed = ", ".join(name for name, value in after.items() if value != before.get(name))
        assert not changed, f"a run changes {changed} of the module; keep memory in self"

    def test_inputs_are_left_alone(self, subject: Subject) -> None:
        """A step writes to no array that it was given."""
        scans = busy_scans(subject.platform, 10)
        _check_repeatable(subject, scans)
        first = subject.run([read_only(scan) for scan in scans])
        _check_same(first, subject.run(scans), "the run differs where scans are writable")

    def test_a_copy_of_a_scan_is_the_same_scan(self, subject: Subject) -> None:
        """A daemon hands each step a copy of the scan: `seq` and `is_new_scan` tell scans apart."""
        scans = busy_scans(subject.platform, 20)
        _check_repeatable(subject, scans)
        pattern = subject.make()
        copies = [
            inputs if inputs.scan is None else structs.replace(inputs, scan=read_only(inputs.scan))
            for inputs in subject.story(pattern, scans)
        ]
        text = "the run differs where each step has a copy of the scan"
        _check_same(subject.steps(pattern, copies), subject.run(scans), text)

    def test_steps_take_little_time(self, subject: Subject) -> None:
        """Half of the steps take at most a tenth of the period, on this machine."""
        pattern = subject.make()
        spent = []
        for inputs in subject.story(pattern, busy_scans(subject.platform, 20)):
            with no_side_effects(subject.kind.__module__):
                began = time.thread_time()
                pattern.step(inputs)
                spent.append(time.thread_time() - began)
        median = sorted(spent)[len(spent) // 2]
        limit = _MAX_STEP_SHARE / subject.kind.rate
        text = f"the median step takes more than {1e3 * limit:.1f} ms, a tenth of its period"
        assert median <= limit, text

    def test_mirrored_scans_give_mirrored_commands(self, subject: Subject) -> None:
        """A pattern with `is_symmetric` answers a mirrored scan by the mirrored command."""
        if not subject.kind.is_symmetric:
            return
        # Where robots have places, these may decide, and then the random generator.
        subject = replace(subject, has_places=False)
        scans = busy_scans(subject.platform, 30)
        _check_repeatable(subject, scans[:5])
        # Without a return the random generator may decide, equally on both sides.
        for scan in (scan for scan in scans if np.isfinite(scan.ranges).any()):
            here = subject.run([scan] * 3)[-1].twist
            there = subject.run([mirrored(scan)] * 3)[-1].twist
            assert (here is None) == (there is None), "a command on one side only"
            if here is not None and there is not None:
                swapped = Twist(there.linear, -there.angular, -there.lateral)
                _check_close(here, swapped, f"mirrored scan {scan.seq}")

    def test_the_order_of_rays_means_nothing(self, subject: Subject) -> None:
        """Rays may come in any order; only their bearings count."""
        _check_repeatable(subject, busy_scans(subject.platform, 5))
        rng = np.random.default_rng(1)
        for scan in busy_scans(subject.platform, 20):
            here = subject.run([scan] * 3)[-1].twist
            there = subject.run([reordered(scan, rng)] * 3)[-1].twist
            _check_close(here or Twist(), there or Twist(), f"reordered scan {scan.seq}")

    def test_parameters_can_be_set_while_it_runs(self, subject: Subject) -> None:
        """`update` between two steps neither raises nor stops the pattern."""
        pattern = subject.make()
        story = list(subject.story(pattern, busy_scans(subject.platform, 10)))
        subject.steps(pattern, story[:10])
        pattern.update(pattern.params)
        with _under("after an update"):
            _check_sane(subject.steps(pattern, story[10:]), subject.platform)

    def test_survives_a_jump_of_time(self, subject: Subject) -> None:
        """A step an hour after the last one, as after a suspend, is a step like any other."""
        pattern = subject.make()
        story = list(subject.story(pattern, busy_scans(subject.platform, 4)))
        subject.steps(pattern, story)
        later = msgspec.structs.replace(story[-1], now=story[-1].now + 3600.0, dt=3600.0)
        with _under("after an hour"):
            _check_sane(subject.steps(pattern, [later]), subject.platform)


@cache
def _loader(plugin_dir: Path | None) -> PatternLoader:
    """The loader of the parts of combined patterns; names are read at the first call."""
    return PatternLoader(places_of(pattern_names(plugin_dir)))


def _messages(pattern: Pattern[Any], index: int) -> tuple[Message, ...]:
    """Messages of neighbours for every fifth step: usual and odd values of each channel's type.

    Values of wrong types are omitted, since the pattern host drops them.
    """
    if index % 5:
        return ()
    sent = [
        Message(f"robot-{number + 2}", channel, value, 0.05)
        for channel, kind in pattern.channels.items()
        for number, value in enumerate(_VALUES.get(kind, ()))
    ]
    return (*sent, Message("robot-2", "no-such-channel", 1, 0.0))


@contextmanager
def _under(circumstances: str) -> Iterator[None]:
    """Add the circumstances as a note to an exception of the block."""
    try:
        yield
    except Exception as error:
        error.add_note(circumstances)
        raise


def _check_sane(run: Iterable[Outputs], platform: Platform) -> None:
    for twist in (outputs.twist for outputs in run):
        if twist is None:
            continue
        assert twist.is_finite, f"the command is {twist}"
        for name in ("linear", "angular", "lateral"):
            value = getattr(twist, name)
            limit = getattr(platform.limits, name)
            text = f"the {name} command is {value:g}, beyond twice the limit of {limit:g}"
            assert abs(value) <= _MAX_LIMIT_RATIO * limit, text


def _check_close(here: Twist, there: Twist, what: str) -> None:
    speeds = msgspec.structs.astuple(here), msgspec.structs.astuple(there)
    is_close = np.allclose(*speeds, rtol=0.0, atol=_TOLERANCE, equal_nan=True)
    assert is_close, f"{what}: {here} and {there}"


def _check_repeatable(subject: Subject, scans: Sequence[Scan | None]) -> None:
    """AssertionError if two runs with equal seeds differ; all further comparisons assume this."""
    first, second = (subject.run(scans, seed=7) for _ in range(2))
    hint = "; chance comes from self.context.rng, and memory belongs on self"
    _check_same(first, second, "two runs with one seed differ", hint)


def _check_same(
    first: Sequence[Outputs], second: Sequence[Outputs], text: str, hint: str = ""
) -> None:
    """AssertionError at the first step whose outputs differ; NaN equals NaN."""
    for step, (here, there) in enumerate(zip(first, second, strict=True)):
        for name in here.__struct_fields__:
            is_same = repr(getattr(here, name)) == repr(getattr(there, name))
            assert is_same, f"{text}, first in the {name} of step {step}{hint}"


def _shared_values(kind: type[Pattern[Any]]) -> dict[str, bytes]:
    """The encoded values of a pattern's module and classes; values that cannot be encoded aside."""
    module = sys.modules[kind.__module__]
    owners = [("", vars(module))] + [
        (f"{name}.", dict(vars(member)))
        for name, member in vars(module).items()
        if isinstance(member, type) and member.__module__ == module.__name__
    ]
    encoded = {}
    for place, values in owners:
        for name, value in values.items():
            if name.startswith("__") or isinstance(value, ModuleType | FunctionType | type):
                continue
            # A value that cannot be encoded, such as a descriptor, is no memory.
            with suppress(TypeError, AttributeError, pickle.PicklingError):
                encoded[f"{place}{name}"] = pickle.dumps(value)
    return encoded
