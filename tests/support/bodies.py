"""Simulated robots in a network namespace; a test asks, each answer is one JSON line.

First {"endpoints": {robot: endpoint}}; then for each `mark` on standard input {"mark": {robot:
true if it was commanded to move since the mark before}}, and for each `moving` and `standing` the
same word once the last command of every robot after that line does so. Robots that follow one of
these two words are those that are meant.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys

from swarmd.core.clock import boottime
from swarmd.settings.settings import load_platform
from tests.support.fake_body import Body


def say(**event: object) -> None:
    print(json.dumps(event), flush=True)


def answer(bodies: dict[str, Body], line: str, marked: float) -> None:
    now = boottime()
    word, *robots = line.split()
    if word == "mark":
        say(mark={robot: body.moved_since(marked) for robot, body in bodies.items()})
        return
    for robot in robots or bodies:
        body = bodies[robot]
        wait = body.wait_moving if word == "moving" else body.wait_zero
        wait(now)
    say(**{word: True})


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--swarm", required=True)
    parser.add_argument("--address", help="listen here, from port 9001 on [127.0.0.1, free ports]")
    parser.add_argument("robots", nargs="+")
    args = parser.parse_args()
    platform = load_platform("waffle_pi")
    with contextlib.ExitStack() as left:
        bodies = {
            robot: left.enter_context(
                Body(
                    platform,
                    swarm=args.swarm,
                    robot=robot,
                    endpoint=args.address and f"tcp/{args.address}:{port}",
                )
            )
            for port, robot in enumerate(args.robots, 9001)
        }
        say(endpoints={robot: body.endpoint for robot, body in bodies.items()})
        marked = boottime()
        for line in sys.stdin:
            now = boottime()
            answer(bodies, line, marked)
            if line.strip() == "mark":
                marked = now


if __name__ == "__main__":
    main()
