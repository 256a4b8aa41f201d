"""Scratch: permits attacked with real processes."""

from __future__ import annotations
import contextlib, time, os, signal
from pathlib import Path
import pytest
from swarmd.core.messages import State
from swarmd.core.verbs import ParamRequest, RunRequest, RosterRequest
from swarmd.core.refusal import Refusal
from swarmd.link.keys.roster import KeyPermit
from swarmd.link.keys.identity import load_identity
from swarmd.operator.session.operator import Operator
from swarmd.settings.platforms import load_platform
from tests.support.fake_body import Body
from tests.support.processes import wait_until
from tests.support.secured_swarm import RUNNING, SecuredSwarm

pytestmark = pytest.mark.integration
HOUR = int(time.time()) + 3600


def permit(*may, **f):
    return KeyPermit(role="some", key=bytes(64), may=may, **{"until": HOUR, **f})


P = {
    "agent": permit("stop"),
    "pupil": permit(
        "stop", "run drive", "run random_walk", "param drive.speed", longest=60.0, speed=0.05
    ),
}


def ask(op, kind, *names, **f):
    def once():
        out = op.request(kind, op.members().epochs(names), **f)
        ask.last = out
        return {*out.replies} == {*names}

    wait_until(once, "answered")
    return {n: (r.code, r.refusal, r.text) for n, r in ask.last.replies.items()}


def test_attack(tmp_path: Path) -> None:
    with contextlib.ExitStack() as left:
        s = SecuredSwarm(tmp_path, left, permits=P, operators=("anna",))
        for r in RUNNING:
            b = left.enter_context(Body(load_platform("waffle_pi"), swarm=s.name, robot=r))
            s.bodies[r] = b.endpoint
            setattr(s, "body_" + r, b)
        s.start()
        pupil = left.enter_context(s.operator("pupil"))
        agent = left.enter_context(s.operator("agent"))
        pupil.members()
        agent.members()
        s.anna.members()
        print(ask(pupil, RunRequest, "r1", "r2", pattern="drive", params={"speed": 0.2}))
        b1 = s.body_r1
        mark = time.monotonic
        from swarmd.core.clock import boottime

        t = boottime()
        b1.wait_stepped(t)
        fast = lambda since: max(
            (abs(c.twist.linear) for c in b1.commands if c.at > since), default=None
        )
        time.sleep(1.0)
        print("fast after run", fast(t))
        # the pattern host dies
        t = boottime()
        os.kill(s.daemons["r1"].host_pid(), signal.SIGKILL)
        b1.wait_stepped(t + 0.5)
        time.sleep(1)
        print("fast after a dead host", fast(t), s.status("r1").state)
        # operator sets a faster parameter on the pupil's run
        print(ask(s.anna, ParamRequest, "r1", params={"speed": 0.2}))
        time.sleep(1)
        t = boottime()
        time.sleep(0.5)
        print("fast after anna's param", fast(t))
        # roster revokes pupil and agent, only r1 hears of it
        s.daemons["r2"].freeze()
        authority = s.keys.authority
        stale_agent = agent
        authority.change(remove=["agent", "pupil"])
        authority.issue("anna").write(s.keys.folder_of("anna"))
        out = s.anna.request(
            RosterRequest,
            s.anna.members().epochs(["r1"]),
            roster=authority.signed_roster,
            secret=authority.secret,
            certificates={},
        )
        print("roster", {k: (v.code, v.text) for k, v in out.replies.items()})
        wait_until(lambda: True, "")
        # open link, at once
        print(
            "revoked, open link:",
            {
                k: (v.code, v.refusal, v.text)
                for k, v in pupil.request(
                    RunRequest, {"r1": None}, pattern="random_walk"
                ).replies.items()
            },
        )
        new = left.enter_context(
            Operator(s.settings, identity=load_identity(s.keys.folder_of("anna")))
        )
        time.sleep(1.0)
        out = new.members()
        print({k: (v.state, v.presence) for k, v in out.members.items()})
        print("run by anna", ask(new, RunRequest, "r1", pattern="drive"))
        t = boottime()
        import threading

        th = threading.Thread(target=lambda: agent.send_stop("stop", timeout=6.0))
        th.start()
        time.sleep(0.6)
        s.daemons["r2"].thaw()
        th.join()
        time.sleep(1.0)
        for r in RUNNING:
            st = None
            from tests.support.swarmctl import heard_statuses

            st = heard_statuses(new, [r])[r]
            print(r, st.state, st.reason, st.detail, st.keys, st.health.dropped)
        print(s.daemons["r1"].text()[-3000:])
        print("-----r2\n", s.daemons["r2"].text()[-2500:])
