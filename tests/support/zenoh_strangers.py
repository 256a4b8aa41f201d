"""Zenoh programs that know nothing of swarmd: `python -m tests.support.zenoh_strangers COUNT`.

COUNT sessions with the configuration that Zenoh has by default, and a scout. Each line of standard
input, the name of a swarm, is answered by one of JSON: `tokens`, the names that each session lists,
and `locators`, those of the peers that answered the scout.
"""

from __future__ import annotations

import contextlib
import json
import sys

import zenoh

from swarmd.core.keys import ANY, named_by, token


def main(count: int) -> None:
    """Open the sessions, and answer until standard input ends."""
    locators = set[str]()
    scout = zenoh.scout(zenoh.handlers.RingChannel(1000), what="peer")
    with contextlib.ExitStack() as left:
        left.callback(scout.stop)
        sessions = [left.enter_context(zenoh.open(zenoh.Config())) for _ in range(count)]
        for line in sys.stdin:
            tokens = []
            for session in sessions:
                replies = session.liveliness().get(token(line.strip(), ANY))
                names = {named_by(str(reply.ok.key_expr)) for reply in replies if reply.ok}
                tokens.append(sorted(filter(None, names)))
            while (hello := scout.try_recv()) is not None:
                locators.update(hello.locators)
            print(json.dumps({"tokens": tokens, "locators": sorted(locators)}), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
