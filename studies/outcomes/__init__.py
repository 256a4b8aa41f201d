"""What each pattern brings about in a swarm: measured over seeds."""
