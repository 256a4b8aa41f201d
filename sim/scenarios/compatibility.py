"""Whether the platforms of a scenario see each other and assume each other's speed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import product

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.messages import PeerFinding
from swarmd.core.values import Platform
from swarmd.protection.compatibility import Accepts, assumed_speed, body_of, findings
from swarmd.settings.layered import Layered
from swarmd.settings.platforms import platform_names
from swarmd.sim.scenarios.groups import Groups
from swarmd.sim.scenarios.schema import ScenarioFile

_WAYS = {
    "unseen": "set radio.range_and_bearing: true, by which robots tell where they are",
    "faster": "set one protection.barrier.others_speed under platforms",
}
_MOST_NAMED = 8
WHOLE_BODIES = "every lidar sees whole bodies here (lidar_visibility: body)"


def check_compatibility(
    layers: Layered, file: ScenarioFile, groups: Groups
) -> tuple[Accepts, tuple[str, ...]]:
    """What robots accept, and a line for each pair that fits only by what the scenario says.

    Raises ConfigError for the pairs that would be held.
    """
    accepts = Accepts.of(file.accepts_unseen, file.accepts_faster)
    names = dict.fromkeys(platform.name for platform in groups.robots.values())
    known = {*names, *file.platforms, *platform_names()}
    for kind, accepted in (("unseen", accepts.unseen), ("faster", accepts.faster)):
        for name in accepted:
            if name not in known:
                key = f"accepts_{kind}"
                raise layers.error((key,), f"{key}: {unknown('platform', name, known)}")
    is_told = file.radio.range_and_bearing
    if file.lidar_visibility == "body":
        accepts = Accepts(dict.fromkeys(names, WHOLE_BODIES), accepts.faster)
    notes, held = [], []
    for own, found in _pairs(groups.robots.values(), accepts):
        if found.kind == "unseen" and found.holds and is_told:
            notes.append(f"{own}: {found.text.partition(';')[0]}; told by range and bearing")
        elif found.holds:
            held.append((own, found))
        elif file.lidar_visibility != "body" or found.kind == "faster":
            notes.append(f"{own}: {found.text}")
    if held:
        raise _refusal(layers, held)
    return accepts, tuple(notes)


def _refusal(layers: Layered, held: Sequence[tuple[str, PeerFinding]]) -> ConfigError:
    """Names the pairs that would be held, and what helps, in one line."""
    pairs = [f"{own}: {found.text.partition(';')[0]}" for own, found in held[:_MOST_NAMED]]
    if len(held) > _MOST_NAMED:
        pairs.append(f"and {len(held) - _MOST_NAMED} more")
    kinds = dict.fromkeys(found.kind for _, found in held)
    ways = [f"see accepts_{kind}, or {_WAYS[kind]}" for kind in kinds]
    return layers.error((f"accepts_{held[0][1].kind}",), "; ".join((*pairs, *ways)))


def has_findings(platforms: Iterable[Platform], accepts: Accepts) -> bool:
    """True if any two of the platforms, or two robots of one, have something between them."""
    return any(True for _ in _pairs(platforms, accepts))


def _pairs(platforms: Iterable[Platform], accepts: Accepts) -> Iterator[tuple[str, PeerFinding]]:
    """Each finding of a platform about another, or about another robot of its own kind."""
    robots = list(platforms)
    kinds = {platform.name: platform for platform in robots}
    counts = Counter(platform.name for platform in robots)
    for own, peer in product(kinds.values(), repeat=2):
        is_alone = own is peer and counts[own.name] == 1
        if is_alone or own.protection["mode"] == "off":  # that promises nothing
            continue
        found = findings(body_of(own), assumed_speed(own), peer.name, body_of(peer), accepts)
        yield from ((own.name, one) for one in found)
