"""What the keys of a stolen robot can forge by datagrams, against real daemons on loopback.

The rows of `docs/evidence/security.md` on the bundle of a robot.
"""

from __future__ import annotations

import contextlib
import socket
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.goal import Goal, encode_goal
from swarmd.core.keys import ANY, SHARED, build, parse
from swarmd.core.messages import Presence, State
from swarmd.core.verbs import RunRequest
from swarmd.link.carriers.session import open_with, session_options
from swarmd.link.carriers.udp import GROUP4, GROUP_PORT
from swarmd.link.datagram import (
    Ack,
    Address,
    Beacon,
    Datagram,
    Flag,
    GoalReport,
    RunLease,
    Solicit,
    Stop,
    pack,
    unpack,
)
from swarmd.link.keys.datagram_keys import KEY_BYTES, reader_keys
from swarmd.link.keys.roster import Role
from swarmd.link.keys.roster_change import SharedRoster
from swarmd.link.signature import Author, Signer
from swarmd.link.spread.pull import _answer
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.session import sign_goal
from tests.support.keys import flipped
from tests.support.processes import free_port, wait_until
from tests.support.secured_swarm import SecuredSwarm

pytestmark = pytest.mark.integration

GROUP: Address = (GROUP4, GROUP_PORT)


class Thief:
    """Sends datagrams that are signed with the keys of the robot `r3`, which does not run."""

    def __init__(self, swarm: SecuredSwarm) -> None:
        self.swarm = swarm
        keys = swarm.keys["r3"].datagram_keys
        self._robot = Signer(keys, Role.ROBOT, "r3")
        named = reader_keys(keys.generation, keys.secret, "anna", is_operator=True, answers={})
        self._operator = Signer(named, Role.OPERATOR, "anna")

    def send(self, body: Datagram, *, as_operator: bool = False, to: Address = GROUP) -> None:
        """Sign as the stolen robot, or with a key of anna that is derived from its secret."""
        signer = self._operator if as_operator else self._robot
        payload = signer.sign(pack(self.swarm.tag, body))
        self.swarm.stranger.mouth.sendto(payload, to)

    def beacon(self, robot: str) -> Beacon:
        """The newest beacon of a robot that was heard."""
        found = [
            body
            for body, _, _ in self.swarm.stranger.recorded(Beacon)
            if isinstance(body, Beacon) and body.robot == robot
        ]
        return found[-1]


class GoalThief(Thief):
    """The robot `r3` in the thief's hands: a member of the swarm that holds `goal`.

    `handed`: how often it has handed the goal to each address that asked for it.
    """

    def __init__(self, swarm: SecuredSwarm, goal: Goal) -> None:
        super().__init__(swarm)
        self._goal = goal
        self._sequence = 0
        self.handed: Counter[Address] = Counter()

    @contextlib.contextmanager
    def at_work(self) -> Iterator[None]:
        """Meanwhile it shows the goal to all, and answers what robots ask."""
        mouth = self.swarm.stranger.mouth
        mouth.settimeout(0.1)
        ended = threading.Event()

        def work() -> None:
            while not ended.is_set():
                self.send(self._shown())
                with contextlib.suppress(TimeoutError):
                    while True:
                        self._answer(*mouth.recvfrom(2000))

        thread = threading.Thread(target=work)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()

    def _shown(self, echo: int = 0) -> Beacon:
        """A beacon with a digest that no robot has, so that each asks for the goal."""
        self._sequence += 1
        digest = self._goal.generation.to_bytes(4, "big") + b"xx"
        return replace(
            self.beacon("r1"),
            robot="r3",
            instance=b"thief3",
            sequence=self._sequence,
            state=0,
            digests=(b"", digest),
            echo=echo,
        )

    def _answer(self, payload: bytes, source: Address) -> None:
        body = unpack(self.swarm.tag, payload)
        if not isinstance(body, Solicit) or body.robot not in (None, "r3"):
            return
        self.send(self._shown(body.echo), to=source)
        if body.wants_goal:
            content = encode_goal(self._goal)
            report = GoalReport(
                robot="r3", instance=b"thief3", echo=body.echo, goal=content, age=1000
            )
            self.send(report, to=source)
            self.handed[source] += 1


class KeyThief:
    """The robot `r3` in the thief's hands, which hands over a newer roster with false keys.

    Then it acks each stop in the name of every robot, with those keys.
    """

    FALSE = b"f" * KEY_BYTES

    def __init__(self, swarm: SecuredSwarm, left: contextlib.ExitStack) -> None:
        self._swarm = swarm
        authority = swarm.keys.authority
        authority.issue("r3").write(swarm.keys.folder_of("r3"))
        identity = swarm.keys["r3"]
        self._names = sorted(identity.roster.robots, key=lambda name: name != "r3")
        self._signer = Signer(identity.datagram_keys, Role.ROBOT, "r3")
        self._signer._pairs["anna"] = self.FALSE
        keys = replace(authority.keys_of("anna"), answers=dict.fromkeys(self._names, self.FALSE))
        self._blob = msgspec.msgpack.encode(SharedRoster(authority.signed_roster, keys=keys))
        port = free_port()
        self._mouth = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        left.callback(self._mouth.close)
        self._mouth.bind(("127.0.0.1", port))
        options = session_options(
            replace(swarm.settings, listen=(f"tcp/127.0.0.1:{port}",)), identity
        )
        del options["access_control"]  # it answers on the keys of other robots as well
        session = open_with(options, "a thief")
        left.callback(session.close)
        session.declare_queryable(build(swarm.name, ANY, SHARED, "roster", ANY), self._hand_over)
        self.asked: set[str] = set()
        self._seen = 0
        self.acked = 0

    def _hand_over(self, query: zenoh.Query) -> None:
        assert query.payload is not None
        key = parse(str(query.key_expr))
        assert key is not None
        self.asked.add(key.robot)
        asked = query.payload.to_bytes()
        query.reply(query.key_expr, _answer(lambda name, asker: self._blob, asked, "anna"))

    def work(self) -> None:
        """Answer what the operator has asked since the last time, as each robot."""
        heard = self._swarm.stranger.recorded(Solicit | Stop)
        for body, _, source in heard[self._seen :]:
            self._seen += 1
            for robot in self._names:
                if isinstance(body, Solicit):
                    beacon = Beacon(
                        robot=robot,
                        instance=b"thief3",
                        sequence=self._seen,
                        wire=3,
                        state=0,
                        revision=1,
                        echo=body.echo,
                    )
                    self._send(beacon, source)
                elif isinstance(body, Stop):
                    self._ack(body.id, robot, source)

    def _ack(self, stop: str, robot: str, source: Address) -> None:
        ack = Ack(id=stop, robot=robot, instance=b"thief3", revision=1, code="applied")
        ack = replace(ack, proof=self._signer.proof(ack, "anna"))
        self._send(ack, source)
        self._send(replace(ack, via="r1"), source)
        self._mouth.sendto(pack(self._swarm.tag, ack), source)  # without a signature
        self.acked += 1

    def _send(self, body: Datagram, to: Address) -> None:
        payload = self._signer.sign(pack(self._swarm.tag, body), Author(Role.OPERATOR, "anna"))
        self._mouth.sendto(payload, to)


@contextlib.contextmanager
def repeated(action: Callable[[], None]) -> Iterator[None]:
    """Meanwhile the action is carried out 50 times a second, in a thread."""
    ended = threading.Event()

    def repeat() -> None:
        while not ended.wait(0.02):
            action()

    thread = threading.Thread(target=repeat)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredSwarm]:
    with contextlib.ExitStack() as left:
        folder = tmp_path_factory.mktemp("secured")
        yield SecuredSwarm(folder, left, names=("r1", "r2", "r3")).start()


@pytest.fixture
def swarm(shared: SecuredSwarm) -> SecuredSwarm:
    """The swarm of the module: both robots stand and hold no latch."""
    shared.calm()
    return shared


@pytest.fixture
def thief(swarm: SecuredSwarm) -> Thief:
    for robot in ("r1", "r2"):
        swarm.stranger.address_of(robot)
    wait_until(lambda: swarm.presence("r2") is Presence.ALIVE, "r2 is alive")
    return Thief(swarm)


def run(swarm: SecuredSwarm) -> None:
    def runs() -> bool:
        view = swarm.anna.members()
        robots = ["r1", "r2"]
        done = swarm.anna.request(RunRequest, view.epochs(robots), pattern="drive")
        return done.exit_code == 0

    wait_until(runs, "both run")


@pytest.mark.parametrize("as_operator", [False, True])
def test_robots_obey_a_stop_in_the_name_of_an_operator(
    swarm: SecuredSwarm, thief: Thief, as_operator: bool
) -> None:
    """Handed on by a robot, or signed with the key of an operator, which robots can derive."""
    run(swarm)
    stop = Stop(
        id=f"forged {as_operator}",
        verb="stop",
        operator="anna",
        hops=0 if as_operator else 1,
        origin=b"thie",
        counter=2**50 + as_operator,
    )
    thief.send(stop, as_operator=as_operator)
    for robot in ("r1", "r2"):
        wait_until(lambda: swarm.status(robot).state is State.STOPPED, f"{robot} is stopped")  # noqa: B023
    assert "by anna" in swarm.daemons["r1"].text()
    assert set(swarm.anna.send_stop("estop").replies) == {"r1", "r2"}  # her next stop counts
    assert swarm.status("r1").state is State.ESTOPPED


def test_what_no_robot_may_sign_is_refused(swarm: SecuredSwarm, thief: Thief) -> None:
    """A stop that was not handed on, a lease of a run, and a robot that is not on the roster."""
    said = len(swarm.daemons["r1"].text())
    thief.send(Stop(id="direct", verb="estop", operator="anna", counter=2**50, origin=b"thie"))
    thief.send(RunLease(id="forged", operator="anna", count=2**40))
    thief.send(replace(thief.beacon("r2"), robot="ghost", instance=b"ghosts"))
    wait_until(lambda: swarm.dropped("r1", "forged") >= 2, "two are refused")
    wait_until(lambda: swarm.dropped("r1", "role") >= 1, "one is not for robots")
    assert swarm.status("r1").latches == {}
    assert "estop" not in swarm.daemons["r1"].text()[said:]
    assert "ghost" not in swarm.anna.members().members


def test_robots_believe_forged_farewells_of_another_robot(
    swarm: SecuredSwarm, thief: Thief
) -> None:
    """Until they hear it again; a stop still waits for that robot, which is on the roster."""

    def forge() -> None:
        beacon = thief.beacon("r2")
        thief.send(replace(beacon, sequence=beacon.sequence + 1, flags=Flag.LEFT))

    with repeated(forge):
        wait_until(lambda: swarm.status("r1").neighbors == (), "r1 has no neighbor")
        outcome = swarm.anna.send_stop("stop")
    assert {"r1", "r2"} <= set(outcome.replies)
    wait_until(lambda: swarm.status("r1").neighbors == ("r2",), "r1 hears r2 again")


def test_no_ack_of_another_robot_counts(swarm: SecuredSwarm, thief: Thief) -> None:
    """A frozen robot is missing in a stop, whatever the thief says in its name."""
    swarm.daemons["r2"].freeze()
    instance = thief.beacon("r2").instance

    def forge() -> None:
        for body, _, source in swarm.stranger.recorded(Stop)[-4:]:
            assert isinstance(body, Stop)
            ack = Ack(id=body.id, robot="r2", instance=instance, revision=1, code="applied")
            for via in ("", "r1", "r3"):
                thief.send(replace(ack, via=via), to=source)

    with repeated(forge):
        outcome = swarm.anna.send_stop("stop")
    swarm.daemons["r2"].thaw()
    assert swarm.stranger.recorded(Stop)
    assert "r1" in outcome.replies
    assert "r2" not in outcome.replies
    assert outcome.exit_code != 0


@pytest.mark.parametrize(
    ("forge", "generation"), [(flipped, 1000), (bytes, 2000)], ids=["flipped", "as it was"]
)
def test_an_old_goal_starts_no_robot_after_an_estop_and_a_reset(
    forge: Callable[[bytes], bytes], generation: int, swarm: SecuredSwarm, thief: Thief
) -> None:
    """As it was signed, or with the other signature of the same content."""
    robots, identity = ["r1", "r2"], swarm.keys["anna"]
    drive: dict[str, Any] = {"pattern": "drive", "on_join": "run", "valid": 600.0}
    goal = sign_goal(Goal(generation=generation, issuer="anna", id="old", **drive), identity)

    def runs() -> bool:
        view = swarm.anna.members()
        done = swarm.anna.request(RunRequest, view.epochs(robots), pattern="drive", goal=goal)
        return done.exit_code == 0

    wait_until(runs, "both run")
    assert swarm.anna.send_stop("estop", select=lambda names: robots).exit_code == 0
    for robot in robots:
        swarm.reset(robot)
    stolen = GoalThief(swarm, replace(goal, signature=forge(goal.signature)))
    with stolen.at_work():
        wait_until(
            lambda: len(stolen.handed) == 2 and min(stolen.handed.values()) > 2,
            "both have taken the goal",
        )
        states = {robot: swarm.status(robot).state for robot in robots}
    assert states == dict.fromkeys(robots, State.IDLE)


def test_questions_of_a_stolen_robot_are_answered(swarm: SecuredSwarm, thief: Thief) -> None:
    swarm.stranger.mouth.settimeout(10.0)
    thief.send(Solicit(echo=77, wants_members=True))
    assert swarm.stranger.mouth.recv(2000)


def test_no_ack_counts_by_keys_that_a_stolen_robot_handed_over(tmp_path: Path) -> None:
    """It brings a newer roster; two robots are frozen, r4 never existed, r5 is new."""
    with contextlib.ExitStack() as left:
        swarm = SecuredSwarm(tmp_path, left, names=("r1", "r2", "r3", "r4")).start()
        authority, anna = swarm.keys.authority, swarm.anna
        for robot in ("r1", "r2"):
            swarm.daemons[robot].freeze()
            left.callback(swarm.daemons[robot].thaw)
        authority.change(add={"r5": Role.ROBOT})
        thief = KeyThief(swarm, left)

        def estop(is_ended: Callable[[], bool], answering: str = "") -> Outcome:
            """Until then, and until the robot `answering` has acked."""
            until, lacking = boottime() + 60.0, {answering} - {""}

            def is_over() -> bool:
                return (is_ended() and not lacking) or boottime() > until

            def show(missing: tuple[str, ...]) -> None:
                lacking.intersection_update(missing)

            return anna.send_stop("estop", until_all=True, is_ended=is_over, on_progress=show)

        def has_acked() -> Callable[[], bool]:
            enough = thief.acked + 100
            return lambda: thief.acked >= enough

        def has(generation: int) -> bool:
            return anna.identity is not None and anna.identity.roster.generation == generation

        with repeated(thief.work):
            estop(lambda: has(3))
            assert has(3)
            outcome = estop(has_acked())
            assert set(outcome.replies) <= {"r3"}
            assert {"r1", "r2", "r4", "r5"} <= set(outcome.missing)
            assert thief.asked == {"r3", "r5"}  # r5 at the address of the thief

            authority.change(remove=["r3"])
            authority.issue("r1").write(swarm.keys.folder_of("r1"))
            swarm.daemons["r1"].kill()
            swarm.spawn("r1").wait_ready()
            estop(lambda: has(4))
            assert has(4)
            outcome = estop(has_acked(), "r1")
        assert set(outcome.replies) == {"r1"}
        assert {"r2", "r4", "r5"} <= set(outcome.missing)
        true = authority.keys_of("anna").answers
        assert swarm.keys["anna"].datagram_keys.answers.items() <= true.items()
