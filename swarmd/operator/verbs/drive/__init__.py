"""`swarmctl drive` and `Swarm.drive`: one robot in the hand of an operator."""
