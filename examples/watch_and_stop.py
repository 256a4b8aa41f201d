"""Runs, watches and stops a simulated swarm."""

import sys

import swarmd

try:
    with swarmd.demo(robots=3) as demo, demo.connect() as swarm:
        print(swarm.run("dispersion", params={"speed": 0.15}).line)
        for state in swarm.states(seconds=3):
            print(state.robot, state.state, state.pattern, state.report)
        print(swarm.stop().line)
        print(swarm.members())
except KeyboardInterrupt:
    sys.exit("interrupted: the simulated swarm has ended")
