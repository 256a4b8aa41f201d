"""What an operator asks of a swarm: for `swarmctl`, the page and Python, without click and print."""
