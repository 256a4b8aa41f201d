"""The verbs of a swarm file: diff and apply."""
