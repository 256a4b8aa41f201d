"""Stop all robots of a swarm: python examples/zenoh/stop.py meadow; with estop: latched"""

import sys
import uuid

import msgpack
import zenoh


def main() -> None:
    """Ask until each robot that is found has answered twice at most, and print the answers."""
    swarm = sys.argv[1]
    verb = "estop" if "estop" in sys.argv else "stop"
    request = {"verb": verb, "id": uuid.uuid4().hex, "operator": "stop.py"}
    payload = b"\x01" + msgpack.packb(request)  # the version of the format, and MessagePack
    config = zenoh.Config()
    config.insert_json5("open/return_conditions/connect_scouted", "true")
    with zenoh.open(config) as session:
        answered: set[str] = set()
        for _ in range(3):  # a robot that is found after the first question gets the next one
            key = f"swarm/{swarm}/*/control/{verb}/anyone"
            for reply in session.get(key, target=zenoh.QueryTarget.ALL, payload=payload):
                answer = msgpack.unpackb(reply.ok.payload.to_bytes()[1:])
                if answer["robot"] not in answered:
                    answered.add(answer["robot"])
                    print(answer["robot"], answer["code"], answer["text"])


if __name__ == "__main__":
    main()
