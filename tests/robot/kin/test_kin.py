"""Names by motion and mutual sight, in a hand-made world without noise."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pytest
from msgspec.structs import replace as changed

from swarmd.core.kin_message import KinMessage
from swarmd.core.values import Neighbor, Odometry, Pose, Scan, Twist
from swarmd.robot.kin.kin import NO_ROBOT, Kin
from swarmd.robot.peer_faults import PeerFaults

PERIOD = 0.2
FREE = Scan(0, 0.0, np.empty(0), np.empty(0), 0.1, 3.5)
HOUR = 3600.0
Path = Callable[[float], tuple[float, float, float]]
Relay = Callable[[str, KinMessage, float], Iterable[tuple[str, KinMessage]]]
Lens = Callable[[float, float], tuple[float, float]]
PILLARS = [(1.5, 0.4), (-1.2, -1.0), (0.2, 1.9)]


def circle(x: float, y: float, radius: float, rate: float, phase: float = 0.0) -> Path:
    """A robot that drives along a circle at `rate` rad/s."""

    def pose(time: float) -> tuple[float, float, float]:
        angle = phase + rate * time
        heading = angle + math.copysign(math.pi / 2, rate)
        return x + radius * math.cos(angle), y + radius * math.sin(angle), heading

    return pose


def stood(path: Path, start: float, end: float) -> Path:
    """A robot that stands from `start` to `end`, and then goes on."""
    return lambda time: path(min(time, start) if time < end else time - end + start)


WALKERS: dict[str, Path] = {
    "a": circle(0.0, -0.5, 0.5, 0.4),
    "b": circle(0.6, 0.9, 0.6, -0.3, 1.0),
    "c": circle(-1.0, 0.5, 0.4, 0.5, 2.0),
}


def seen_from(
    frame: tuple[float, float, float], pose: tuple[float, float, float]
) -> tuple[float, float, float]:
    """A pose of the world in a frame."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    dx, dy = pose[0] - frame[0], pose[1] - frame[1]
    return c * dx + s * dy, c * dy - s * dx, math.remainder(pose[2] - frame[2], math.tau)


class Seen(NamedTuple):
    """A track in the base frame."""

    id: int
    x: float
    y: float


class Place(NamedTuple):
    """A place that is known."""

    distance: float
    bearing: float
    heading: float
    age: float
    error: float


@dataclass
class World:
    """Robots that see all within 3.5 m, and the frames of their odometry."""

    paths: dict[str, Path] = field(default_factory=lambda: dict(WALKERS))
    clocks: dict[str, float] = field(default_factory=dict)
    loss: float = 0.0
    relay: Relay = lambda id, told, time: [(id, told)]
    silent: frozenset[str] = frozenset()
    hidden: frozenset[str] = frozenset()  # robots of which nobody sees a track
    scan: Callable[[World, str], Scan] = lambda world, id: FREE
    lenses: dict[str, Lens] = field(default_factory=dict)  # of a lidar: what it makes of a place
    # The peers whose lidar may miss a robot, and the robots whose lidar leaves out directions.
    missed_by: dict[str, frozenset[str]] = field(default_factory=dict)
    partial: frozenset[str] = frozenset()
    standing: frozenset[str] = frozenset()  # robots whose base has the command zero
    odometers: dict[str, Path] = field(default_factory=dict)  # what is not the true pose
    time: float = 0.0

    def __post_init__(self) -> None:
        self.rng = random.Random(4)
        self.frames = {id: (k - 1.0, 0.5 * k, 0.7 * k) for k, id in enumerate(self.paths)}
        self.kins = {id: Kin(is_partial=id in self.partial) for id in self.paths}
        self.peer_faults = {id: PeerFaults() for id in self.paths}
        self.bodies: list[str | tuple[float, float]] = [*self.paths, *PILLARS]

    def now(self, id: str) -> float:
        return self.time + self.clocks.get(id, 0.0)

    def place(self, index: int) -> tuple[float, float]:
        """Where body `index` is."""
        body = self.bodies[index]
        return self.paths[body](self.time)[:2] if isinstance(body, str) else (body[0], body[1])

    def run(self, seconds: float, check: Callable[[], None] = lambda: None) -> None:
        for _ in range(round(seconds / PERIOD)):
            self.time += PERIOD
            for id, kin in self.kins.items():
                own = self.paths[id](self.time)
                measured = self.odometers.get(id, self.paths[id])(self.time)
                odometry = Odometry(
                    self.time, Pose(*seen_from(self.frames[id], measured)), Twist(0.0, 0.0)
                )
                kin.on_odometry(odometry, self.now(id))
                tracks: list[Any] = []
                for index, body in enumerate(self.bodies):
                    x, y, _ = seen_from(own, (*self.place(index), 0.0))
                    if body != id and body not in self.hidden and math.hypot(x, y) < 3.5:
                        if id in self.lenses:
                            x, y = self.lenses[id](x, y)
                        tracks.append(Seen(index, x, y))
                kin.observe(tracks, self.scan(self, id), self.now(id))
                opinions = kin.opinions(self.missed_by.get(id, frozenset()), self.now(id))
                if opinions is not None:
                    self.peer_faults[id].judge(opinions, self.now(id))
            for id, kin in self.kins.items():
                told = kin.next_message(self.now(id), True, id in self.standing)
                if told is None:
                    continue
                for other, listener in self.kins.items():
                    if other != id and id not in self.silent and self.rng.random() >= self.loss:
                        for name, one in self.relay(id, told, self.time):
                            listener.on_message(name, one, self.now(other))
            check()

    def names(self, id: str) -> dict[str, str | None]:
        """The name of each robot and pillar that robot `id` tracks."""
        names = self.kins[id].names(self.now(id))
        return {str(self.bodies[track]): name for track, name in names.items()}

    def peer(self, id: str, name: str) -> Place:
        """Where robot `id` knows the peer `name`."""
        (one,) = self.kins[id].complete((Neighbor(name, 9.0),), self.now(id))
        assert one.distance is not None
        assert one.bearing is not None
        assert one.heading is not None
        assert one.error is not None
        return Place(one.distance, one.bearing, one.heading, one.age, one.error)

    def faults(self, id: str) -> dict[str, str]:
        """The kind of the fault of each robot that robot `id` knows or suspects."""
        return {one.robot: one.kind for one in self.peer_faults[id].at(self.now(id))}

    def wrong(self) -> list[tuple[str, str, str]]:
        """Viewer, body and name of each wrong name."""
        return [
            (id, body, name)
            for id in self.kins
            for body, name in self.names(id).items()
            if name and name != body
        ]


def test_names_robots_and_says_where_they_are() -> None:
    world = World()
    world.run(20.0)
    for id in "abc":
        names = world.names(id)
        for other in set("abc") - {id}:
            assert names[other] == other
            peer = world.peer(id, other)
            x, y, heading = seen_from(world.paths[id](world.time), world.paths[other](world.time))
            assert peer.distance == pytest.approx(math.hypot(x, y), abs=0.02)
            assert peer.bearing == pytest.approx(math.atan2(y, x), abs=0.02)
            assert math.remainder(peer.heading - heading, math.tau) == pytest.approx(0, abs=0.1)
            assert peer.age == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("first", [-3.14, 0.7], ids=["as they turn", "from the right ahead"])
@pytest.mark.parametrize(("near", "aside", "is_kept"), [(0.2, 3.3, True), (3.3, 0.2, False)])
def test_rays_that_cross_the_place_of_a_peer_end_its_pose(
    near: float, aside: float, is_kept: bool, first: float
) -> None:
    """`near`: m of the rays within 10 degrees of a peer without a track; `aside`: of the others."""
    bearings = np.remainder(first + np.arange(360) * math.tau / 360 + math.pi, math.tau) - math.pi

    def scan(world: World, id: str) -> Scan:
        ranges = np.full(360, aside)
        if "b" in world.hidden and id != "b":
            x, y, _ = seen_from(world.paths[id](world.time), world.paths["b"](world.time))
            off = np.remainder(bearings - math.atan2(y, x) + math.pi, math.tau) - math.pi
            ranges[np.abs(off) < math.radians(10.0)] = near
        return Scan(0, 0.0, ranges, bearings, 0.1, 3.5)

    world = World(scan=scan)
    world.run(20.0)
    assert world.names("a")["b"] == "b"
    world.hidden = frozenset({"b"})
    world.run(5.0)
    (one,) = world.kins["a"].complete((Neighbor("b", 0.0),), world.now("a"))
    assert (one.distance is not None) == is_kept


def test_a_viewer_that_asks_changes_no_later_answer() -> None:
    """A recording has no such call: a replay would give the pattern other places."""
    viewed, alone = World(), World()
    for _ in range(60):
        for world in (viewed, alone):
            world.run(PERIOD)
        scanned_at = alone.time
        viewed.time = scanned_at + 0.05
        viewed.names("a")
        viewed.kins["a"].complete((Neighbor("b", 9.0),), viewed.now("a"))
        viewed.time = alone.time = scanned_at + 0.1
        for name in "bc":
            found, wanted = (
                world.kins["a"].complete((Neighbor(name, 9.0),), world.now("a"))
                for world in (viewed, alone)
            )
            assert found == wanted
        viewed.time = alone.time = scanned_at
    assert alone.peer("a", "b").age == pytest.approx(0.0, abs=0.01)
    alone.time += 0.1
    assert alone.peer("a", "b").age == pytest.approx(0.1, abs=0.01)


def test_what_stands_while_all_move_is_no_robot() -> None:
    world = World()
    world.run(20.0)
    assert {name for body, name in world.names("a").items() if len(body) > 1} == {NO_ROBOT}


def test_a_robot_that_has_never_moved_is_unknown() -> None:
    world = World(paths=WALKERS | {"c": lambda time: (-1.0, 0.5, 0.3)})
    world.run(20.0)
    assert world.names("a")["c"] is None
    assert world.names("a")["b"] == "b"


def test_a_name_stays_while_the_peer_rests() -> None:
    world = World(paths=WALKERS | {"c": stood(WALKERS["c"], 15.0, 45.0)})
    world.run(15.0)
    named: list[bool] = []
    world.run(30.0, lambda: named.append(world.names("a")["c"] == "c"))
    assert all(named)
    assert world.wrong() == []


def test_a_peer_that_is_silent_for_ten_seconds_is_unknown() -> None:
    """No message forgets a silent peer, and its place is the last that was heard of it."""
    world = World()
    world.run(20.0)
    world.silent = frozenset("b")
    silent_since = world.time
    world.run(10.0 - PERIOD)
    kin = world.kins["a"]

    def places() -> list[float | None]:
        known = (Neighbor("b", 9.0), Neighbor("c", 9.0))
        return [one.distance for one in kin.complete(known, world.now("a"))]

    world.time = silent_since + 10.0 - 1e-6
    assert None not in places()
    world.time = silent_since + 10.0 + 1e-6
    silent, heard = places()
    assert silent is None
    assert heard is not None
    world.run(PERIOD)
    assert "b" not in world.names("a").values()
    assert world.names("a")["c"] == "c"


def test_clocks_an_hour_apart_change_nothing() -> None:
    worlds = [World(), World(clocks={"a": HOUR, "c": -HOUR})]
    for world in worlds:
        world.run(20.0)
    assert worlds[0].names("b") == worlds[1].names("b")
    assert worlds[1].names("b")["a"] == "a"
    first, second = (world.peer("b", "a") for world in worlds)
    assert first.bearing == pytest.approx(second.bearing, abs=1e-3)
    assert first.distance == pytest.approx(second.distance, abs=1e-3)


@pytest.mark.parametrize("robot", ["a", "b"])
def test_a_reset_of_odometry_ends_the_name_until_new_evidence(robot: str) -> None:
    world = World()
    world.run(20.0)
    world.frames[robot] = (4.0, -2.0, 2.0)
    world.run(PERIOD)
    assert world.names("a")["b"] is None
    wrong: list[tuple[str, str, str]] = []
    world.run(20.0, lambda: wrong.extend(world.wrong()))
    assert wrong == []
    assert world.names("a")["b"] == "b"


def test_half_of_the_messages_suffice() -> None:
    world = World(loss=0.5)
    wrong: list[tuple[str, str, str]] = []
    world.run(40.0, lambda: wrong.extend(world.wrong()))
    assert wrong == []
    assert world.names("a")["b"] == "b"


def test_a_liar_that_copies_all_of_a_peer_takes_no_name_that_is_known() -> None:
    def relay(id: str, told: KinMessage, time: float) -> list[tuple[str, KinMessage]]:
        return [(id, told), ("liar", told)] if id == "b" and time > 20.0 else [(id, told)]

    world = World(relay=relay)
    world.run(20.0)
    names: set[str | None] = set()
    world.run(30.0, lambda: names.add(world.names("a")["b"]))
    assert names == {"b"}
    assert "liar" not in world.names("a").values()


def test_a_liar_from_the_start_makes_its_victim_unknown_until_it_is_silent() -> None:
    def relay(id: str, told: KinMessage, time: float) -> list[tuple[str, KinMessage]]:
        return [(id, told), ("liar", told)] if id == "b" and time < 20.0 else [(id, told)]

    world = World(relay=relay)
    names: set[str | None] = set()
    world.run(20.0, lambda: names.add(world.names("a").get("b")))
    assert names == {None}
    assert world.names("a")["c"] == "c"
    world.run(10.4)  # silent peers are forgotten after 10 s
    assert world.names("a")["b"] == "b"


def test_a_liar_that_copies_a_path_alone_is_never_named() -> None:
    def relay(id: str, told: KinMessage, time: float) -> list[tuple[str, KinMessage]]:
        copy = ("liar", changed(told, objects=b""))
        return [copy, (id, told)] if id == "b" else [(id, told)]

    world = World(relay=relay)
    names: set[str | None] = set()
    world.run(30.0, lambda: names.add(world.names("a").get("b")))
    assert "liar" not in names
    assert world.names("a")["b"] == "b"


def in_step() -> dict[str, Path]:
    """Two robots drive the same path 0.8 m apart; a third robot sees both."""
    lead = circle(-0.4, 0.6, 0.4, 0.4)

    def second(time: float) -> tuple[float, float, float]:
        x, y, yaw = lead(time)
        return x + 0.8, y, yaw

    return {"watcher": circle(0.2, -0.8, 0.3, -0.5), "lead": lead, "second": second}


def test_robots_in_step_are_told_apart_by_what_they_see() -> None:
    world = World(paths=in_step())
    wrong: list[tuple[str, str, str]] = []
    world.run(30.0, lambda: wrong.extend(world.wrong()))
    assert wrong == []
    names = world.names("watcher")
    assert (names["lead"], names["second"]) == ("lead", "second")


def test_robots_in_step_that_tell_no_objects_are_unknown() -> None:
    world = World(paths=in_step(), relay=lambda id, told, time: [(id, changed(told, objects=b""))])
    found: set[str | None] = set()
    world.run(30.0, lambda: found.update(world.names("watcher")[x] for x in ("lead", "second")))
    assert found == {None}


def test_nothing_is_named_by_a_peer_that_is_elsewhere() -> None:
    far = {"far": circle(50.0, 0.0, 0.5, 0.4), "other": circle(53.0, 0.0, 0.4, -0.3)}
    world = World(paths=WALKERS | far, silent=frozenset("abc"))
    names: set[str | None] = set()
    world.run(30.0, lambda: names.update(world.names("a").values()))
    assert names <= {None, NO_ROBOT}


@pytest.mark.parametrize("seed", range(4))
def test_random_histories_keep_one_peer_a_track_and_one_track_a_peer(seed: int) -> None:
    rng = random.Random(seed)
    paths = WALKERS | {"d": circle(-0.2, -1.6, 0.3, 0.6)}

    def relay(id: str, told: KinMessage, time: float) -> list[tuple[str, KinMessage]]:
        """Garbles, copies and repeats at random."""
        sent = [(id, told)]
        if rng.random() < 0.1:
            sent.append((rng.choice(["b", "x", "y"]), changed(told, stamp=told.stamp + 1)))
        if rng.random() < 0.05:
            sent.append(
                (id, changed(told, stamp=told.stamp + 2, objects=rng.randbytes(rng.randrange(33))))
            )
        if rng.random() < 0.05:
            sent.append((id, changed(told, resets=rng.randrange(3), yaw=rng.randrange(6000))))
        return sent

    world = World(paths=paths, loss=0.2, relay=relay)

    def check() -> None:
        for id, kin in world.kins.items():
            names = [name for name in kin.names(world.now(id)).values() if name]
            assert len(names) == len(set(names))
            assert set(names) <= {"b", "x", "y", *paths} - {id}
            for name in names:
                assert all(map(math.isfinite, world.peer(id, name)))

    world.run(16.0, check)


@pytest.mark.parametrize("side", [1, -1], ids=["left", "right"])
def test_a_message_has_the_eight_nearest_objects(side: int) -> None:
    kin = Kin(middle=-0.1, resets=7)
    kin.on_odometry(Odometry(1.0, Pose(2.0, 1.0, math.pi / 6), Twist(0.0, 0.0)), 1.0)
    objects: list[Any] = []
    for k in range(11, -1, -1):  # 0.1 m and 0.1 rad further each
        far, bearing = 1.1 + 0.1 * k, 0.1 * k * side
        objects.append(Seen(k, far * math.cos(bearing) - 0.1, far * math.sin(bearing)))
    kin.observe(objects, FREE, 1.0)
    told = kin.next_message(1.0, True, False)
    assert told is not None
    assert (told.x, told.y, told.yaw) == (1913, 950, 524)  # the middle lies behind the axle
    assert (told.stamp, told.resets, told.asks) == (1000, 7, True)
    seen = list(struct.iter_unpack(">Hh", told.objects))
    assert seen == [(1100 + 100 * k, 100 * k * side) for k in range(8)]


def test_a_robot_tells_five_times_a_second_while_it_moves_and_once_at_rest() -> None:
    kin = Kin()
    told: list[float] = []
    for tick in range(100):  # a lidar of 10 Hz; at rest from 5 s on
        now = 0.1 * tick
        way = min(0.2 * now, 1.0)
        kin.on_odometry(Odometry(now, Pose(way, 0.0, 0.0), Twist(0.0, 0.0)), now)
        kin.observe([], FREE, now)
        if kin.next_message(now, False, False) is not None:
            told.append(now)
    assert [round(now, 1) for now in told[:26]] == [round(0.2 * k, 1) for k in range(26)]
    assert [round(now, 1) for now in told[26:]] == [6.0, 7.0, 8.0, 9.0]


@pytest.mark.parametrize("far", [math.nan, math.inf, -math.inf, 1e13, 1e300])
def test_a_robot_whose_odometry_no_message_can_hold_tells_nothing(far: float) -> None:
    kin = Kin()
    kin.on_odometry(Odometry(0.0, Pose(far, 0.0, 0.0), Twist()), 0.0)
    kin.observe([Seen(1, 1.0, 0.0)], FREE, 0.0)
    assert kin.next_message(0.0, True, False) is None


@pytest.mark.parametrize("far", [math.nan, math.inf, 1e300])
def test_a_track_that_no_message_can_hold_is_told_in_bounds(far: float) -> None:
    kin = Kin()
    kin.on_odometry(Odometry(0.0, Pose(), Twist()), 0.0)
    kin.observe([Seen(1, far, 0.0)], FREE, 0.0)
    told = kin.next_message(0.0, True, False)
    assert told is None or len(told.objects) == 4
