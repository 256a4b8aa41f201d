"""Simulated robots in a network namespace; a test asks, each answer is one JSON line.

First {"endpoints": {robot: endpoint}}; then for each `mark` on standard input {"mark": {robot:
true if it was commanded to move since the mark before}}, and for each `moving` and `standing` the
same word once the last command of every robot after that line does so.
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


def answer(bodies: dict[str, Body], word: str, marked: float) -> None:
    now = boottime()
    if word == "mark":
        say(mark={robot: body.moved_since(marked) for robot, body in bodies.items()})
        return
    for body in bodies.values():
        wait = body.wait_moving if word == "moving" else body.wait_zero
        wait(now)
    say(**{word: True})


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--swarm", required=True)
    parser.add_argument("robots", nargs="+")
    args = parser.parse_args()
    platform = load_platform("waffle_pi")
    with contextlib.ExitStack() as left:
        bodies = {
            robot: left.enter_context(Body(platform, swarm=args.swarm, robot=robot))
            for robot in args.robots
        }
        say(endpoints={robot: body.endpoint for robot, body in bodies.items()})
        marked = boottime()
        for line in sys.stdin:
            word, now = line.strip(), boottime()
            answer(bodies, word, marked)
            if word == "mark":
                marked = now


if __name__ == "__main__":
    main()
