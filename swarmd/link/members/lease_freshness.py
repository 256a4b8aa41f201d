"""Detection of replayed and delayed run leases without a shared clock. Pure: leases and times in.

Only secured swarms use this module. A signed `RunLease` that an attacker has recorded keeps its
valid signature for ever, and a robot that joins late or restarts does not know which counts its
operator has sent. So the operator writes into the lease of each robot what the clock of this robot
showed at the least when the lease was sent (`operator/session/clocks.py`), with the instance
of the robot, which is one life (start to end) of its daemon.

1. A lease counts from the time that it states on the robot's own clock, not from its arrival. So a
   lease that is replayed or held back prolongs no run beyond the time of the lease after the
   operator's last word, however late it comes.
2. A lease for another instance, such as an earlier life of this robot or another robot, does not
   count. Nor does a lease without a time, as an older version sends it.
3. A lease of a time to come does not count: it could be replayed then. The clock of an operator's
   machine may jump; the operator then reads the clock of the robot again.
"""

from __future__ import annotations

from swarmd.link.datagram import RunLease

MAX_AHEAD = 0.05
"""Seconds by which a lease may seem to be of a time to come: rounding, and the drift of clocks."""


def lease_age(lease: RunLease, instance: bytes, now: float) -> float | None:
    """Seconds since the lease was sent, at most; None if the lease does not show it.

    `instance`: of this robot. `now`: s on its clock.
    """
    if lease.instance != instance:
        return None
    age = now - lease.clock / 1000.0  # ms
    return None if age < -MAX_AHEAD else max(age, 0.0)
