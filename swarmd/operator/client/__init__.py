"""What an operator asks of a swarm, for `swarmctl`, the page and Python: no click, no printing."""
