"""Whose lidar does not fit and who strays, in the hand-made world of test_kin.py."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.kin_message import KinMessage
from swarmd.core.messages import DOUBTED, MISFIT, STRAYS
from swarmd.core.values import Scan
from swarmd.robot.kin.kin import Kin
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenariofile import scenario_of
from tests.robot.kin.test_kin import (
    WALKERS,
    Lens,
    Path,
    Relay,
    World,
    circle,
    seen_from,
    stood,
)

ENOUGH = 150.0  # s, of three robots that see each other nearly all the time


def turned(degrees: float) -> Lens:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return lambda x, y: (c * x - s * y, s * x + c * y)


def longer(by: float) -> Lens:
    def place(x: float, y: float) -> tuple[float, float]:
        share = 1.0 + by / math.hypot(x, y)
        return share * x, share * y

    return place


LENSES: dict[str, Lens] = {
    "turned by 10 degrees": turned(10.0),
    "turned by -10 degrees": turned(-10.0),
    "turned by 90 degrees": turned(90.0),
    "mirrored": lambda x, y: (x, -y),
    "0.3 m long": longer(0.3),
}
SOUND: dict[str, Lens] = {"sound": lambda x, y: (x, y), "turned by 2 degrees": turned(2.0)}


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())
def test_all_robots_name_the_one_whose_lidar_is_wrong_and_no_other(lens: Lens) -> None:
    world = World(lenses={"c": lens})
    world.run(ENOUGH)
    for id in "ab":
        assert world.faults(id) == {"c": MISFIT}
        (fault,) = world.peer_faults[id].at(world.now(id))
        other = "b" if id == "a" else "a"
        assert (fault.by, fault.tellers) == (2, (other, "self"))
        assert fault.figure
        assert fault.since < ENOUGH
    assert world.faults("c")["c"] == MISFIT  # it learns that of the others
    assert MISFIT not in {kind for robot, kind in world.faults("c").items() if robot != "c"}


@pytest.mark.parametrize("lens", SOUND.values(), ids=SOUND.keys())
def test_nobody_is_named_or_doubted_while_all_lidars_are_right(lens: Lens) -> None:
    world = World(lenses={"c": lens})
    world.run(ENOUGH)
    assert [world.faults(id) for id in "abc"] == [{}, {}, {}]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["walk", "in step", "a person"])
def test_nobody_is_named_or_doubted_in_a_sound_swarm(kind: str, seed: int) -> None:
    """A person is a body that tells nothing; `in step` four robots drive congruent circles."""
    rng = random.Random(seed)
    paths = {
        id: circle(rng.uniform(-1, 1), rng.uniform(-1, 1), 0.5, rng.uniform(0.3, 0.5), rng.random())
        for id in "abcd"
    }
    if kind == "in step":
        paths = {id: circle(1.0 * n, 0.1 * seed * n, 0.5, 0.4) for n, id in enumerate("abcd")}
    world = World(paths, silent=frozenset("d" if kind == "a person" else ""), loss=0.1)

    def check() -> None:
        assert [world.faults(id) for id in "abcd"] == [{}] * 4

    world.run(ENOUGH, check)


def test_two_in_step_of_which_one_is_hidden_are_not_judged() -> None:
    """The paths of both fit the one track, and neither tells an object, so it has no name."""

    def relay(id: str, told: KinMessage, time: float) -> Iterable[tuple[str, KinMessage]]:
        yield id, replace(told, objects=b"") if id in "ab" else told

    paths = {"a": WALKERS["a"], "b": circle(5.0, 5.0, 0.5, 0.4), "c": WALKERS["c"]}
    world = World(paths, relay=relay, hidden=frozenset("b"))
    world.run(ENOUGH)
    assert world.faults("c") == {}
    alone = World({id: paths[id] for id in "ac"}, relay=relay)
    alone.run(ENOUGH)
    assert alone.faults("c") == {"a": DOUBTED}  # the control


def test_of_two_robots_none_can_tell_the_culprit() -> None:
    world = World({id: WALKERS[id] for id in "ac"}, lenses={"c": LENSES["mirrored"]})
    world.run(ENOUGH)
    assert world.faults("a") == {"c": DOUBTED}
    assert world.faults("c").keys() <= {"a"}
    assert MISFIT not in world.faults("c").values()


def test_a_lidar_that_is_right_again_is_named_no_more() -> None:
    world = World(lenses={"c": LENSES["0.3 m long"]})
    world.run(ENOUGH)
    world.lenses.clear()
    world.run(ENOUGH)
    assert [world.faults(id) for id in "abc"] == [{}, {}, {}]


def rests(path: Path, start: float) -> Path:
    return stood(path, start, math.inf)


@pytest.mark.parametrize("is_told", [True, False], ids=["odometry right", "odometry stands"])
def test_a_robot_that_moves_while_it_tells_that_it_stands_strays(is_told: bool) -> None:
    world = World(odometers={} if is_told else {"c": rests(WALKERS["c"], 30.0)})
    world.run(30.0)
    assert world.names("a")["c"] == world.names("b")["c"] == "c"
    world.standing = frozenset("c")
    world.run(8.0)
    for id in "ab":
        assert world.faults(id) == {"c": STRAYS}
    assert world.faults("c") == {"c": STRAYS}
    world.standing = frozenset()
    world.run(3.0)
    assert STRAYS not in {*world.faults("a").values(), *world.faults("b").values()}


def test_a_robot_that_strayed_once_is_named_for_half_a_minute() -> None:
    """It is pushed by 0.4 m in 2 s, and stands on."""
    path = WALKERS["c"]
    moved = {"from": math.inf}

    def pushed(time: float) -> tuple[float, float, float]:
        x, y, yaw = path(min(time, 30.0))
        return x + 0.2 * min(max(time - moved["from"], 0.0), 2.0), y, yaw

    world = World({**WALKERS, "c": pushed})
    world.run(30.0)
    world.standing = frozenset("c")
    world.run(10.0)
    assert world.faults("a") == {}
    moved["from"] = world.time
    world.run(5.0)
    assert world.faults("a") == {"c": STRAYS}
    world.run(40.0)
    assert [world.faults(id) for id in "abc"] == [{}, {}, {}]


@pytest.mark.parametrize("is_told", [False, True])
def test_a_robot_that_stands_before_and_after_messages_that_are_lost_does_not_stray(
    is_told: bool,
) -> None:
    """It stands for 4 s, turns by 1 rad in 1 s, and so on; nobody hears it while it turns."""
    x, y, yaw = WALKERS["c"](0.0)

    def turns(time: float) -> tuple[float, float, float]:
        whole, rest = divmod(time, 5.0)
        return x, y, yaw + whole + max(rest - 4.0, 0.0)

    def is_turning(time: float) -> bool:
        return time % 5.0 >= 4.0 - 1e-6

    def relay(id: str, told: KinMessage, time: float) -> Iterable[tuple[str, KinMessage]]:
        if id != "c" or not is_turning(time) or is_told:
            yield id, told

    world = World({**WALKERS, "c": turns}, relay=relay)
    for _ in range(round(ENOUGH / 0.2)):
        world.standing = frozenset() if is_turning(world.time + 0.2) else frozenset("c")
        world.run(0.2)
        assert [world.faults(id) for id in "abc"] == [{}, {}, {}]


def test_a_robot_whose_track_passes_to_one_that_drives_by_does_not_stray() -> None:
    """Robot c stands, as rays show. Its track follows a body that drives off after 35.5 s."""
    x, y, yaw = WALKERS["c"](30.0)
    bearings = np.radians(np.arange(-180.0, 180.0))

    def track(time: float) -> tuple[float, float, float]:
        if time < 30.0:
            return WALKERS["c"](time)
        return x - 0.25 * max(time - 35.5, 0.0), y, yaw

    def scan(world: World, id: str) -> Scan:
        place = seen_from(world.paths[id](world.time), (x, y, 0.0))
        off = np.remainder(bearings - math.atan2(place[1], place[0]) + math.pi, math.tau) - math.pi
        near = np.abs(off) < math.radians(8.0)
        return Scan(0, 0.0, np.where(near, 0.2, 3.4), bearings, 0.1, 3.5)

    world = World({**WALKERS, "c": track}, scan=scan, odometers={"c": rests(WALKERS["c"], 30.0)})
    world.run(30.0)
    assert world.names("a")["c"] == world.names("b")["c"] == "c"
    world.standing = frozenset("c")

    def check() -> None:
        assert [world.faults(id) for id in "ab"] == [{}, {}]

    world.run(12.0, check)


@pytest.mark.parametrize("share", [1.0, 1.04])
def test_a_robot_that_turns_by_wrong_odometry_takes_nobody_to_stray(share: float) -> None:
    """Robot a turns at 1.5 rad/s, of which its odometry makes some more; c stands."""

    def turns(share: float) -> Path:
        def pose(time: float) -> tuple[float, float, float]:
            x, y, yaw = WALKERS["a"](min(time, 30.0))
            return x, y, yaw + 1.5 * share * max(time - 30.0, 0.0)

        return pose

    world = World(
        {**WALKERS, "a": turns(1.0), "c": stood(WALKERS["c"], 30.0, math.inf)},
        odometers={"a": turns(share)},
    )
    world.run(30.0)
    world.standing = frozenset("c")

    def check() -> None:
        assert STRAYS not in world.faults("a").values()
        assert DOUBTED not in world.faults("a").values()

    world.run(20.0, check)


def see_a_part(id: str, told: KinMessage, time: float) -> Iterable[tuple[str, KinMessage]]:
    """Robot c tells the objects alone that are within 70 degrees of its direction ahead."""
    if id == "c":
        pairs = [pair for pair in struct.iter_unpack(">Hh", told.objects) if abs(pair[1]) < 1222]
        told = replace(told, objects=b"".join(struct.pack(">Hh", *pair) for pair in pairs))
    yield id, told


@pytest.mark.parametrize("is_known", [True, False])
def test_a_lidar_that_leaves_out_directions_fits(is_known: bool) -> None:
    world = World(relay=see_a_part, partial=frozenset("c" if is_known else ""))
    world.run(ENOUGH)
    named = set(world.faults("a").items()) | set(world.faults("b").items())
    assert named == (set() if is_known else {("c", MISFIT)})  # the control


def look_over_robots(id: str, told: KinMessage, time: float) -> Iterable[tuple[str, KinMessage]]:
    """The lidar of robot c is higher than all other robots."""
    yield id, replace(told, objects=b"") if id == "c" else told


@pytest.mark.parametrize("is_known", [True, False])
def test_a_lidar_that_looks_over_a_robot_fits(is_known: bool) -> None:
    over = dict.fromkeys("ab", frozenset("c")) if is_known else {}
    world = World(relay=look_over_robots, missed_by=over)
    world.run(ENOUGH)
    named = set(world.faults("a").items()) | set(world.faults("b").items())
    assert named == (set() if is_known else {("c", MISFIT)})  # the control


@pytest.mark.parametrize(("near", "is_doubted"), [(0.3, False), (0.5, True), (math.nan, True)])
def test_a_robot_beside_a_wall_need_not_be_told(near: float, is_doubted: bool) -> None:
    """A wall at a gap of 0.1 m and the robot are one object for a lidar 1.8 m away."""
    bearings = np.radians(np.arange(-180.0, 180.0))
    ranges = np.where(np.abs(bearings) < 0.5, near, 3.4)
    scan = Scan(0, 0.0, ranges, bearings, 0.1, 3.5)
    world = World(relay=look_over_robots, scan=lambda world, id: scan)
    world.kins = {id: Kin(radius=0.2) for id in world.kins}
    world.run(ENOUGH)
    assert ("c" in world.faults("a")) is ("c" in world.faults("b")) is is_doubted


@pytest.mark.parametrize("moves", [True, False])
def test_a_robot_that_drives_or_stands_as_it_tells_does_not_stray(moves: bool) -> None:
    paths = WALKERS if moves else {**WALKERS, "c": rests(WALKERS["c"], 30.0)}
    world = World(dict(paths))
    world.run(30.0)
    world.standing = frozenset() if moves else frozenset("c")
    world.run(30.0)
    assert [world.faults(id) for id in "abc"] == [{}, {}, {}]


# One robot that lies, or is broken

FORMATION: dict[str, Path] = {id: circle(x, 0.0, 0.4, 0.4) for x, id in enumerate("abc")}


def blames(id: str, told: KinMessage, time: float) -> Iterable[tuple[str, KinMessage]]:
    """Robot b blames all others of all."""
    others = ("a", "c", "d")
    yield (
        id,
        replace(told, doubted=others, straying=others, fitting=9) if id == "b" else told,
    )


def turns_objects(id: str, told: KinMessage, time: float) -> Iterable[tuple[str, KinMessage]]:
    """Robot b tells objects elsewhere, and blames the others for it."""
    if id == "b":
        pairs = struct.iter_unpack(">Hh", told.objects)
        objects = b"".join(struct.pack(">Hh", d, (b + 1570) % 3141) for d, b in pairs)
        told = replace(told, objects=objects, doubted=("a", "c"), fitting=9)
    yield id, told


def jumps(id: str, told: KinMessage, time: float) -> Iterable[tuple[str, KinMessage]]:
    """Robot b tells places that jump, up to the greatest numbers of a message."""
    far = (0, 300, -2_000, 10**9)[int(time) % 4]
    yield id, replace(told, x=told.x + far, y=told.y - far) if id == "b" else told


def repeats(id: str, told: KinMessage, time: float) -> Iterable[tuple[str, KinMessage]]:
    """Robot b tells an old place in each second message, and late."""
    yield id, told
    if id == "b":
        yield id, replace(told, stamp=max(told.stamp - 1_000, 0), x=0, y=0)


def copies(id: str, told: KinMessage, time: float) -> Iterable[tuple[str, KinMessage]]:
    """Robot b tells in its own name what robot a tells."""
    if id != "b":
        yield id, told
    if id == "a":
        yield "b", replace(told, doubted=("c",), straying=("c",), fitting=3)


def garbles(id: str, told: KinMessage, time: float) -> Iterable[tuple[str, KinMessage]]:
    """Robot b tells objects at the greatest and least numbers."""
    yield id, replace(told, objects=b"\xff\xff\x7f\xff\x00\x00\x80\x00") if id == "b" else told


@pytest.mark.parametrize(
    "relay", [blames, turns_objects, jumps, repeats, copies, garbles], ids=lambda one: one.__name__
)
@pytest.mark.parametrize("paths", [WALKERS, FORMATION], ids=["walk", "formation"])
def test_one_liar_gets_no_other_robot_named(relay: Relay, paths: dict[str, Path]) -> None:
    world = World({**paths, "d": circle(0.4, -1.4, 0.4, -0.5)}, relay=relay)

    def check() -> None:
        for id in "acd":
            named = {robot for robot, kind in world.faults(id).items() if kind != DOUBTED}
            assert named <= {"b"}

    world.run(ENOUGH, check)


def test_a_robot_without_numbers_for_places_is_not_judged() -> None:
    world = World(lenses={"c": lambda x, y: (math.nan, math.inf)})
    world.run(ENOUGH)
    assert set(world.faults("a").values()) <= {DOUBTED, MISFIT}
    assert MISFIT not in {kind for robot, kind in world.faults("a").items() if robot != "c"}


# The table of docs/evidence/faults.md, in lockstep

FAULTY = "w-02"
WALK = {"platform": "waffle_pi", "start": {"layout": "random", "clearance": 0.3}}
TABLE: dict[str, tuple[dict[str, Any] | None, float]] = {
    "lidar 0.3 m long": ({"scan": "offset", "offset": 0.3}, 300.0),
    "lidar mirrored": ({"scan": "mirrored"}, 300.0),
    "lidar turned by 90 degrees": ({"scan": "turned", "angle_deg": 90}, 300.0),
    "lidar turned by 10 degrees": ({"scan": "turned", "angle_deg": 10}, 900.0),
    "base ignores zero, and a stop after 30 s": ({"base": "ignores_zero"}, 60.0),
    "none": (None, 300.0),
}


@pytest.mark.evidence
@pytest.mark.parametrize("name", TABLE)
def test_which_faults_of_a_lidar_and_a_base_peers_name(name: str) -> None:
    fault, duration = TABLE[name]
    events: list[dict[str, Any]] = [{"at": 30, "stop": FAULTY}] if "zero" in name else []
    if fault is not None:
        events.insert(0, {"at": 2, "fault": fault, "robots": FAULTY})
    asks = {"prefix": "asks", "count": 1, "pattern": "attraction", "parameters": {"kin": True}}
    poles = ((1.0, 1.0, 0.12), (-1.2, 0.5, 0.12), (0.2, -1.3, 0.15))
    made = scenario_of(
        {
            "duration": duration,
            "arena": {
                "size": [4.5, 4.5],
                "poles": [{"at": [x, y], "radius": radius} for x, y, radius in poles],
            },
            "realism": "realistic",
            "groups": {
                "asks": {**WALK, **asks},
                "walks": {**WALK, "prefix": "w", "count": 4, "pattern": "random_walk"},
            },
            "events": events,
        }
    )
    times: list[float] = []
    others: set[str] = set()
    for seed in range(17000, 17020):
        lab = Lockstep(made, seed)
        named: set[str] = set()
        while lab.world.time < duration - 1e-6 and not named:
            lab.advance(1.0)
            for shell in lab.shells:
                assert shell is not None
                found = shell.robot.status(lab.world.time).peer_faults
                named |= {one.robot for one in found if one.kind != DOUBTED}
        times += [lab.world.time - 2.0] if FAULTY in named and fault is not None else []
        others |= named - ({FAULTY} if fault is not None else set())
    print(f"{name}: named in {len(times)} of 20, after {sorted(times)} s")
    assert others == set()
