"""Lockstep: a whole swarm in one process, of the same robots as live ones."""
