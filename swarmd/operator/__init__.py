"""What an operator runs: `swarmctl`, the page, and what Python asks of a swarm."""
