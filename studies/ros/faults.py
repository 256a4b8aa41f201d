"""The faults of the study: for each, the action that injects it and the actions that repair it.

The chain is the world's nodes on DDS, the bridge and the daemons (`chain.py`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from studies.ros.chain import Chain
from studies.ros.node import Faults
from studies.ros.robots import BASE, LIDAR, ROBOTS, STRANGER
from swarmd.core.messages import Presence
from tests.support.ros2_bridge import free_domain

VICTIM = ROBOTS[0]
DDS_LEASE = 14.0
"""Seconds after which a bridge has removed a killed node; DDS keeps it for 10 s."""
ZEROS = "lidar gives zeros only"
SEEN = 2.55
"""m to a wall of which 48 degrees are within 2.8 m, 80 % of the range of the lidar.

Zeros mean no return, as in an open field. Protection notices that 44 degrees of a surface that near
are lost at once (docs/evidence/sensing.md).
"""

Act = Callable[[Chain], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One row of the table.

    The course of a row: 1. `inject`. 2. After `lasts` s the operator gives `order`. 3. After
    `stays` s more, `mend`. 4. `mend_more`, if robots do not drive again.
    """

    name: str
    inject: Act
    mend: Act
    bound: float
    """Seconds from the begin of the fault after which no command to move may reach the base.

    The documentation states this time; inf: it states none."""
    mend_more: Act | None = None
    robots: Sequence[str] = (VICTIM,)
    """The robots that the fault concerns."""
    wall: float = math.inf
    """m, the distance of the nearest wall at most, when the fault is injected."""
    bodies: Sequence[str] = ()
    """Further bodies that the fault may move."""
    lasts: float = 5.0
    stays: float = 0.0
    order: str = "stop"
    begins_later: bool = False
    """The fault begins when `inject` returns, not when it is called."""
    is_fault: bool = True
    """False: a load without a fault, under which the robots must drive on."""
    look: Callable[[Chain], str] = lambda chain: ""
    """What peers of the robot report of the fault; empty without a report."""


def faults() -> tuple[Fault, ...]:
    """All faults, in the order of the table."""
    return (
        *_of_the_bridge(),
        *_of_the_base(),
        *_of_a_second_robot(),
        *_of_commands_and_odometry(),
        *_of_the_lidar(),
        *_of_the_daemon(),
    )


def _of_the_bridge() -> Sequence[Fault]:
    return (
        Fault(
            name="bridge killed, started again 5 s later",
            inject=lambda chain: chain.bridge.kill(),
            mend=lambda chain: chain.bridge.start(),
            bound=1.0,
            robots=ROBOTS,
        ),
        Fault(
            name="bridge killed and started again at once",
            inject=Chain.restart_bridge,
            mend=_nothing,
            bound=math.inf,
            robots=ROBOTS,
            lasts=4.0,
        ),
        *(
            Fault(
                name=f"bridge frozen for {seconds:g} s",
                inject=lambda chain: chain.bridge.freeze(),
                mend=lambda chain: chain.bridge.thaw(),
                bound=1.0,
                robots=ROBOTS,
                lasts=seconds,
                mend_more=Chain.restart_bridge,
            )
            for seconds in (2.0, 6.0, 12.0)
        ),
        Fault(
            name="bridge frozen, and `swarmctl estop` meanwhile",
            inject=lambda chain: chain.bridge.freeze(),
            mend=lambda chain: chain.bridge.thaw(),
            bound=1.0,
            robots=ROBOTS,
            lasts=0.3,
            stays=2.0,
            order="estop",
        ),
        Fault(
            name="bridge in another domain (ROS_DOMAIN_ID)",
            inject=lambda chain: chain.restart_bridge(free_domain()),
            mend=Chain.restart_bridge,
            bound=1.0,
            robots=ROBOTS,
            lasts=6.0,
        ),
    )


def _of_the_base() -> Sequence[Fault]:
    return (
        Fault(
            name="node of the base killed, started again 14 s later",
            inject=lambda chain: chain.nodes[VICTIM, "base"].kill(),
            mend=lambda chain: chain.start_node(VICTIM, "base"),
            mend_more=Chain.restart_bridge,
            bound=1.0,
            lasts=DDS_LEASE,
        ),
        Fault(
            name="node of the base killed and started again at once",
            inject=_restart_base,
            mend=_nothing,
            mend_more=Chain.restart_bridge,
            bound=4.0,
            lasts=DDS_LEASE,
        ),
        Fault(
            name="node of the base ended in order and started again",
            inject=partial(_restart_base, is_orderly=True),
            mend=_nothing,
            mend_more=Chain.restart_bridge,
            bound=math.inf,
        ),
    )


def _of_a_second_robot() -> Sequence[Fault]:
    return (
        Fault(
            name="a second robot's nodes in this namespace, under other names",
            inject=partial(_start_stranger, base="other_base", lidar="other_lidar"),
            mend=_end_stranger,
            mend_more=Chain.restart_bridge,
            bound=4.0,
            begins_later=True,
            bodies=(STRANGER,),
            lasts=8.0,
        ),
        Fault(
            name="a second robot's nodes in this namespace, under the same names",
            inject=partial(_start_stranger, base=BASE, lidar=LIDAR),
            mend=_end_stranger,
            mend_more=Chain.restart_bridge,
            bound=4.0,
            begins_later=True,
            bodies=(STRANGER,),
            lasts=12.0,
        ),
        Fault(
            name="a second base alone in this namespace, under another name",
            inject=partial(_start_stranger, base="other_base"),
            mend=_end_stranger,
            mend_more=Chain.restart_bridge,
            bound=4.0,
            begins_later=True,
            bodies=(STRANGER,),
            lasts=8.0,
        ),
        Fault(
            name="a second base in this namespace that is no ROS node",
            inject=partial(_start_stranger, base=""),
            mend=_end_stranger,
            mend_more=Chain.restart_bridge,
            bound=1.5,
            begins_later=True,
            bodies=(STRANGER,),
            lasts=8.0,
        ),
    )


def _of_commands_and_odometry() -> Sequence[Fault]:
    return (
        Fault(
            name="base started again without its namespace",
            inject=partial(_restart_base, at="/", is_orderly=True),
            mend=partial(_restart_base, is_orderly=True),
            mend_more=Chain.restart_bridge,
            bound=1.0,
            lasts=6.0,
        ),
        Fault(
            name="base started again that wants TwistStamped",
            inject=partial(_restart_base, is_stamped=True, is_orderly=True),
            mend=partial(_restart_base, is_orderly=True),
            mend_more=Chain.restart_bridge,
            bound=math.inf,  # the driver follows the base's type
            lasts=6.0,
        ),
        Fault(
            name="another node drives: 50 commands per second",
            inject=lambda chain: chain.start_node(VICTIM, "teleop"),
            mend=lambda chain: chain.nodes[VICTIM, "teleop"].end(),
            bound=0.5,
            begins_later=True,
        ),
        Fault(
            name="no odometry",
            inject=lambda chain: chain.nodes[VICTIM, "base"].set(Faults(is_silent=True)),
            mend=lambda chain: chain.nodes[VICTIM, "base"].set(Faults()),
            bound=math.inf,
        ),
        Fault(
            name="clock of the odometry 30 s ahead, 5 s later right again",
            inject=lambda chain: chain.nodes[VICTIM, "base"].set(Faults(clock=30.0)),
            mend=lambda chain: chain.nodes[VICTIM, "base"].set(Faults()),
            bound=math.inf,
        ),
    )


def _of_the_lidar() -> Sequence[Fault]:
    wrong = (
        ("lidar repeats its last message", Faults(scans="repeated"), 0.9),
        ("lidar repeats its ranges, with new stamps", Faults(scans="frozen"), 0.9),
        (ZEROS, Faults(scans="zeros"), 0.7),
        ("lidar at a third of its rate, 1.7 Hz", Faults(every=3), math.inf),
        ("lidar at twice its rate, 10 Hz", Faults(copies=2), math.inf),
        ("lidar silent", Faults(is_silent=True), 0.7),
        ("clock of the lidar 30 s ahead, 5 s later right again", Faults(clock=30.0), math.inf),
    )
    return (
        *(
            Fault(
                name=name,
                inject=partial(_set_lidar, faults=faults),
                mend=partial(_set_lidar, faults=Faults()),
                bound=bound,
                wall=SEEN if name == ZEROS else math.inf,
            )
            for name, faults, bound in wrong
        ),
        Fault(
            name="node of the lidar killed, started again 14 s later",
            inject=lambda chain: chain.nodes[VICTIM, "lidar"].kill(),
            mend=lambda chain: chain.start_node(VICTIM, "lidar"),
            mend_more=Chain.restart_bridge,
            bound=0.7,
            lasts=DDS_LEASE,
        ),
        Fault(
            name="a second lidar publishes this scan, under another name",
            inject=partial(_start_stranger, lidar="other_lidar"),
            mend=_end_stranger,
            mend_more=Chain.restart_bridge,
            bound=4.0,
            begins_later=True,
            lasts=8.0,
        ),
    )


def _of_the_daemon() -> Sequence[Fault]:
    return (
        Fault(
            name="daemon killed (kill -9)",
            inject=lambda chain: chain.daemons[VICTIM].kill(),
            mend=_start_daemon,
            bound=0.6,
            look=_what_peers_say,
        ),
        Fault(
            name="daemon frozen for 5 s",
            inject=lambda chain: chain.daemons[VICTIM].freeze(),
            mend=lambda chain: chain.daemons[VICTIM].thaw(),
            bound=0.6,
            look=_what_peers_say,
        ),
        Fault(
            name="daemon started again with namespace `tb3_1`",
            inject=lambda chain: chain.restart_daemon(VICTIM, "tb3_1"),
            mend=lambda chain: chain.restart_daemon(VICTIM),
            bound=1.0,
            lasts=6.0,
        ),
        Fault(
            name="no fault: four busy processes beside the chain",
            is_fault=False,
            inject=lambda chain: chain.set_load(4),
            mend=lambda chain: chain.set_load(0),
            bound=math.inf,
            robots=ROBOTS,
        ),
    )


def _nothing(chain: Chain) -> None:
    """No repair: `inject` has restarted the process already."""


def _restart_base(
    chain: Chain, *, at: str | None = None, is_stamped: bool = False, is_orderly: bool = False
) -> None:
    base = chain.nodes[VICTIM, "base"]
    if is_orderly:
        base.end()
    else:
        base.kill()
    chain.start_node(VICTIM, "base", at=at, is_stamped=is_stamped)


def _start_stranger(chain: Chain, *, base: str | None = None, lidar: str = "") -> None:
    if base is not None:
        chain.start_node(VICTIM, "base", body=STRANGER, name=base)
    if lidar:
        chain.start_node(VICTIM, "lidar", body=STRANGER, name=lidar)


def _end_stranger(chain: Chain) -> None:
    for key in [key for key in chain.nodes if key[0] == STRANGER]:
        chain.nodes.pop(key).end()


def _set_lidar(chain: Chain, *, faults: Faults) -> None:
    chain.nodes[VICTIM, "lidar"].set(faults)


def _start_daemon(chain: Chain) -> None:
    chain.start_daemon(VICTIM).wait_ready()
    chain.look()


def _what_peers_say(chain: Chain) -> str:
    member = chain.operator.members(timeout=0.5).members.get(VICTIM)
    gone = member is not None and member.presence is not Presence.ALIVE
    return f"peers: {member.presence}" if member is not None and gone else ""
