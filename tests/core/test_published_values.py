"""A published value is its field with its words, and what fills it; all readers follow.

`shown` adds a field to the status and one to the emergency stop: to the source of each of these
modules, in a process of its own. All other code is as it stands: whatever copies fields by name, or
shows them by name, loses the new one. The stop goes from its operator to a robot as a datagram,
from there to a peer and to the disk.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from msgspec import Struct
from msgspec.structs import fields

from swarmd.core.messages import DecisionSummary, Health, Latch, Status

ROOT = Path(__file__).parents[2]
TILT = '    tilt: Annotated[Angle | None, shown("Protection", "tilted by", "rad")] = None\n'
BUTTON = '    button: Annotated[Word, shown("Emergency stops", "by button")] = ""\n'
SENT = '    button: Word = ""\n'
ADDED = [
    ("core.messages", "    words: dict[Word, Line] = {}\n", TILT),
    ("core.messages", '    reason: Line = ""\n    age: Seconds | None = None\n', BUTTON),
    ("core.verbs", "    is_relayed: bool = False\n", SENT),
    ("link.datagram", '    clock: Word = ""\n    issued: Seconds = 0.0\n', SENT),
    ("robot.status", "        goal=lifecycle.goals.status(now),\n", "        tilt=0.25,\n"),
    (
        "operator.session.operator",
        "            clock=clock_id(),\n            issued=now,\n",
        '            button="door 3",\n',
    ),
]
"""Of each added line: its module, the text before it, and the line itself."""
WITH_FIELDS = """
import sys
from importlib.util import find_spec, module_from_spec
from pathlib import Path

def build(name, texts):
    spec = find_spec(name)
    text = Path(spec.origin).read_text()
    for below, added in texts:
        assert text.count(below) == 1, (name, below)
        text = text.replace(below, below + added)
    module = sys.modules[name] = module_from_spec(spec)
    exec(compile(text, spec.origin, "exec"), vars(module))
"""
READERS = """
import contextlib, json, runpy
from types import SimpleNamespace as Stub
from msgspec import to_builtins
from swarmd.operator.verbs.members.ask import Members
from swarmd.core.codec import Decoder, encode
from swarmd.core.clock import boottime
from swarmd.core.events import LatchesInput
from swarmd.core.messages import Presence, Status
from swarmd.daemon.store import LatchFile
from swarmd.link.datagram import pack, tag_of, unpack
from swarmd.operator.session.members_view import Contact, MembersView, SeenMember
from swarmd.operator.session.operator import Operator
from swarmd.link.spread.latch_sync import latch_parts
from swarmd.operator.verbs.members.words import health
from swarmd.operator.view.live import LiveSource
from tests.daemon.test_requests import server_of
from tests.support.stub_patterns import idle

tag = tag_of("field", "lab")
def carried(datagram):
    return unpack(tag, pack(tag, datagram))

class Sent(Exception): pass
def send(pending, discovery, *rest, **options):
    raise Sent(next(iter(pending.datagrams(boottime())))[0])
operator = Stub(
    _check_role=str, name="anna", _numbered=lambda stop: (stop, None), _stops=Stub(send=send),
    _new_discovery=lambda now: Stub(known=frozenset(), left=lambda now: frozenset(),
    result=lambda now: MembersView({}),
    doubted=frozenset(), holders=lambda name: ()),
)
try:
    Operator.send_stop(operator, "estop", reason="smoke")
except Sent as sent:
    stop = carried(sent.args[0])
first, second = idle(), idle()
server_of(first.robot.id, first.send).stop(stop, "10.0.0.5:1", print)
(part,) = latch_parts("r1", b"abcdef", first.robot.aged_latches(first.now))
second.step(LatchesInput(carried(part).held))
file = LatchFile(Path(sys.argv[1]))
record = second.robot._lifecycle.latches.record()
file.write(record)
assert file.read().held == record.held

status = Decoder(Status)(encode(second.status))
here = {"presence": Presence.ALIVE, "age": 0.0, "contact": Contact.ANSWERED}
member = SeenMember(robot="r1", instance=status.instance, status=status, **here)
view = MembersView({"r1": member}, answered=frozenset({"r1"}))
page = Stub(statuses=lambda: {"r1": (status, 0.0)}, view=view, descriptions={})
reference = runpy.run_path("docs/site/reference.py")
print(json.dumps({
    "describe, Python": str(Members(view).describe("r1")),
    "members": "\\n".join(health(view)),
    "page": LiveSource.detail(page, "r1"),
    "json": to_builtins(member)["status"],
    "docs": reference["part"]("payloads"),
}))
"""


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What each reader shows of a robot with both fields."""
    modules: dict[str, list[tuple[str, str]]] = {}
    for name, below, line in ADDED:
        modules.setdefault(f"swarmd.{name}", []).append((below, line))
    built = "".join(f"build({name!r}, {texts!r})\n" for name, texts in modules.items())
    done = subprocess.run(
        [sys.executable, "-c", WITH_FIELDS + built + READERS, tmp_path_factory.mktemp("one")],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env={"PYTHONPATH": f"{ROOT}:{ROOT / 'docs/site'}"},
    )
    assert done.returncode == 0, done.stderr
    readers: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return readers


@pytest.mark.integration
def test_a_field_of_the_status_reaches_all_readers(shown: dict[str, Any]) -> None:
    assert re.search(r"^  tilted by +0\.25 rad$", shown["describe, Python"], re.MULTILINE)
    assert ["tilted by", "0.25 rad"] in dict(shown["page"]["sections"])["Protection"]
    assert shown["json"]["tilt"] == 0.25
    assert "| `tilt` | number or nil, in rad |" in shown["docs"]


@pytest.mark.integration
def test_a_field_of_an_emergency_stop_reaches_all_readers(shown: dict[str, Any]) -> None:
    (latch,) = shown["json"]["latches"].values()
    assert latch["button"] == "door 3"
    told = r"by anna, \d+ ms ago, for swarm, by button door 3: smoke"
    assert len(re.findall(told, shown["describe, Python"])) == 2, "why, and Emergency stops"
    assert re.search(rf"^emergency stop: tb3-01 \({told}\)$", shown["members"], re.MULTILINE)
    assert re.search(told, shown["page"]["why"])
    (row,) = dict(shown["page"]["sections"])["Emergency stops"]
    assert re.fullmatch(told, row[1])
    assert shown["docs"].count("| `button` | text |") == 2, "of the request and of the latch"


@pytest.mark.parametrize(
    ("kind", "by_hand"),
    [
        (
            Status,
            "robot driver profile is_secured state since latches params report decision health"
            " readings stale_readings events scan_delay peers findings goal keys words"
            " peer_faults",
        ),
        (
            DecisionSummary,
            "mode is_active requested_linear requested_angular requested_lateral safe_linear"
            " safe_angular safe_lateral rows is_recovering duty decisions speed_share avoiding",
        ),
        (Health, "dropped driver_up"),
        (Latch, "issuer reason age"),
    ],
)
def test_each_other_field_has_words(kind: type[Struct], by_hand: str) -> None:
    """A field without words is shown by code of operator/texts/, or by a verb: `goal`."""
    described = fields(kind)
    wordless = [
        field.name
        for field in described
        if not any(words.extra for words in getattr(field.type, "__metadata__", ()))
    ]
    assert wordless == by_hand.split()
