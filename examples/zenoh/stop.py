"""Stop all robots of a swarm: python examples/zenoh/stop.py meadow; with estop: latched"""

import sys
import time
import uuid

import msgpack
import zenoh

SWARM, VERB = sys.argv[1], "estop" if "estop" in sys.argv else "stop"
REQUEST = {"verb": VERB, "id": uuid.uuid4().hex, "operator": "stop.py"}
KEY = f"swarm/{SWARM}/*/control/{VERB}/anyone"
names, missing, codes = set[str](), set[str](), dict[str, str]()
with zenoh.open(zenoh.Config()) as session:
    # Scouting finds robots one by one: ask for 1 s, and for 5 s while a name lacks an answer.
    start = time.monotonic()
    while (age := time.monotonic() - start) < 1 or (age < 5 and (missing or not names)):
        replies = session.liveliness().get(f"swarm/{SWARM}/*")
        names |= {str(reply.ok.key_expr).rpartition("/")[2] for reply in replies if reply.ok}
        request = b"\x01" + msgpack.packb(REQUEST | {"age": age})  # the version, and MessagePack
        for reply in session.get(KEY, target=zenoh.QueryTarget.ALL, payload=request, timeout=1):
            answer = msgpack.unpackb(reply.ok.payload.to_bytes()[1:]) if reply.ok else {}
            if answer and not answer.get("is_moving") and answer["robot"] not in codes:
                codes[answer["robot"]] = answer["code"]
                print(answer["robot"], answer["code"], answer["text"])
        missing = names - codes.keys()
        time.sleep(0.1)
for name in missing:
    print(name, "has not stopped: out of reach, still moving, or a program")
sys.exit(bool(missing) or {*codes.values()} != {"applied"})
