"""The verbs of swarmctl that need the simulator: sim, demo and exp."""
