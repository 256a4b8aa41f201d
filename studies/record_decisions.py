"""Records decisions of mode `barrier` in adverse scenes, which tests replay.

`python -m studies.record_decisions` writes the file of tests/support/decision_corpus.py. For each
scene, the file has the inputs and decisions of one robot in a few seconds: the robot and the
seconds with the most limited decisions. Inputs are rounded, so that the file is small.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from studies.safety.scenes import Scene, scenario
from swarmd.core.values import Platform, Scan, TouchZone, Twist
from swarmd.robot.protection.decision import DecisionContext, ModeDecision
from swarmd.robot.protection.footprint import ScanGeometry
from swarmd.robot.protection.modes import is_barrier, make_mode
from swarmd.sim.lockstep.lockstep import Lockstep
from tests.support import decision_corpus as corpus

if TYPE_CHECKING:
    from swarmd.robot.protection.barrier import Barrier

SCENES = (
    Scene("ram", "burger"),
    Scene("ram", "burger", "real"),
    Scene("ram", "waffle_pi"),
    Scene("ram", "waffle_pi", "real"),
    Scene("ram", "jackal"),
    Scene("ram", "jackal", "real"),
    Scene("ram", "mixed"),
    Scene("behind", "mixed", "real"),
    Scene("lead", "jackal", "real"),
    Scene("rush", "burger"),
    Scene("rush", "waffle_pi", "real"),
    Scene("rush", "jackal", "real"),
    Scene("rush", "mixed"),
    Scene("swap", "burger", "real"),
    Scene("swap", "jackal", "real"),
    Scene("twists", "burger", "real"),
    Scene("twists", "waffle_pi"),
    Scene("twists", "mixed"),
    Scene("goals", "waffle_pi", "real"),
    Scene("goals", "jackal"),
)
SECONDS = 25.0
DECISIONS = 110
FURTHEST = 4.0  # m: returns beyond constrain no robot


class Recording:
    """A mode that records its inputs; all else is that of `mode`."""

    def __init__(self, mode: Barrier) -> None:
        self.events: list[corpus.Event] = []
        self._mode = mode

    def __getattr__(self, name: str) -> Any:
        return getattr(self._mode, name)

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """Note the scan."""
        self.events.append(corpus.scan_event(scan, FURTHEST, context))
        self._mode.observe(scan, geometry, context)

    def decide(
        self, requested: Twist, context: DecisionContext, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """Note the request."""
        decision = self._mode.decide(requested, context, command=command, touch=touch)
        event = corpus.Event(corpus.rounded(context), [], corpus.short(requested))
        event.command, event.is_active = corpus.short(command), decision.is_active
        self.events.append(event)
        return decision


def stream_of(scene: Scene, seed: int) -> corpus.Stream:
    """The stream of the robot of a scene that is limited most often."""
    run = Lockstep(scenario(scene), seed)
    recordings: list[tuple[Platform, Recording]] = []
    for shell, platform in zip(run.shells, run.world.platforms, strict=True):
        assert shell is not None
        protection = shell.robot._protection
        if is_barrier(protection._mode):
            recording = Recording(protection._mode)
            protection._mode = recording
            recordings.append((platform, recording))
    run.advance(SECONDS)
    best = max(recordings, key=lambda one: limited(busiest(one[1].events)))
    platform = best[0]
    settings = dict(platform.protection["barrier"])
    stream = corpus.Stream(scene.name, kind_of(platform), settings, busiest(best[1].events))
    for event, decision in corpus.decided(stream, make_mode(corpus.platform_of(stream))):
        event.twist, event.is_active = decision.twist, decision.is_active
    return stream


def busiest(events: list[corpus.Event]) -> list[corpus.Event]:
    """The part of `events` with the most limited decisions.

    A part begins with a scan and has DECISIONS decisions and their scans.
    """
    begins = [n for n, event in enumerate(events) if event.requested is None]
    length = DECISIONS + DECISIONS // 7
    parts = [events[n : n + length] for n in begins if n + length <= len(events)]
    return max(parts, key=limited)


def limited(events: Sequence[corpus.Event]) -> int:
    """The number of decisions in which protection limits the request."""
    return sum(event.is_active for event in events)


def kind_of(platform: Platform) -> str:
    """The platform file with the outline and the sensor of a platform."""
    return next(kind for kind in ("burger", "waffle_pi", "jackal") if kind in platform.name)


def main() -> None:
    streams = [stream_of(scene, seed) for seed, scene in enumerate(SCENES)]
    corpus.write(streams)
    count = sum(event.requested is not None for stream in streams for event in stream.events)
    active = sum(limited(stream.events) for stream in streams)
    print(f"{count} decisions, {active} of them limited; {corpus.FILE.stat().st_size} bytes")


if __name__ == "__main__":
    main()
