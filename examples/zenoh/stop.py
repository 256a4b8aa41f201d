"""Stop all robots of a swarm: python examples/zenoh/stop.py meadow; with estop: latched"""

import sys
import time
import uuid

import msgpack
import zenoh

SWARM, VERB = sys.argv[1], "estop" if "estop" in sys.argv else "stop"
REQUEST = {"verb": VERB, "id": uuid.uuid4().hex, "operator": "stop.py"}
names: set[str] = set()
answered: set[str] = set()
with zenoh.open(zenoh.Config()) as session:
    # Scouting finds robots one by one: ask for 1 s, and for 5 s while a name lacks an answer.
    start = time.monotonic()
    while (age := time.monotonic() - start) < 1 or (age < 5 and (not names or names - answered)):
        replies = session.liveliness().get(f"swarm/{SWARM}/*")
        names |= {str(reply.ok.key_expr).rpartition("/")[2] for reply in replies if reply.ok}
        key = f"swarm/{SWARM}/*/control/{VERB}/anyone"
        request = b"\x01" + msgpack.packb(REQUEST | {"age": age})  # the version, and MessagePack
        for reply in session.get(key, target=zenoh.QueryTarget.ALL, payload=request, timeout=1):
            answer = msgpack.unpackb(reply.ok.payload.to_bytes()[1:]) if reply.ok else {}
            if answer and not answer["is_moving"] and answer["robot"] not in answered:
                answered.add(answer["robot"])
                print(answer["robot"], answer["code"], answer["text"])
        time.sleep(0.1)
for name in names - answered:
    print(name, "has not stopped: out of reach, still moving, or a program")
sys.exit(0 if answered else f"no robot of {SWARM} answered")
