"""Stop all robots of a swarm: python examples/zenoh/stop.py meadow tb3-01 tb3-02

The robots that are named must answer; without names, each name with a token. Those that have not
answered are named at the end. With the word estop the stop is latched.
"""

import sys
import time
import uuid

import msgpack
import zenoh

LIMIT, QUIET = 5.0, 1.0  # s: at most; and without a new name, after which all count as found


def main() -> None:
    """Repeat the query, since robots are found one by one, until each has answered."""
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    swarm, *words = sys.argv[1:]
    verb = "estop" if "estop" in words else "stop"
    named = {*words} - {"estop"}
    wanted, codes, newest = {*named}, dict[str, str](), 0.0
    request = {"verb": verb, "id": uuid.uuid4().hex, "operator": "stop.py"}
    key = f"swarm/{swarm}/*/control/{verb}/anyone"
    start = time.monotonic()
    with zenoh.open(zenoh.Config()) as session:
        while (age := time.monotonic() - start) < LIMIT:
            tokens = session.liveliness().get(f"swarm/{swarm}/*")
            found = {str(token.ok.key_expr).rpartition("/")[2] for token in tokens if token.ok}
            if not named and not found <= wanted:
                wanted |= found
                newest = age
            payload = b"\x01" + msgpack.packb({**request, "age": age})  # version, MessagePack
            every = zenoh.QueryTarget.ALL
            for reply in session.get(key, target=every, payload=payload, timeout=1.0):
                answer = msgpack.unpackb(reply.ok.payload.to_bytes()[1:]) if reply.ok else {}
                if answer and not answer.get("is_moving") and answer["robot"] not in codes:
                    codes[answer["robot"]] = answer["code"]
                    print(answer["robot"], answer["code"], answer["text"])
            if wanted and wanted <= codes.keys() and (named or age - newest > QUIET):
                break
            time.sleep(0.1)
    missing = wanted - codes.keys()
    for name in sorted(missing):
        print(name, "has not answered that it stopped: out of reach, still moving, or a program")
    if not wanted:
        print(f"no robot of {swarm} was found")
    sys.exit(bool(missing) or {*codes.values()} != {"applied"})


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("interrupted: perhaps not each robot has stopped")
