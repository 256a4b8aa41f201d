"""What each pattern brings about in a swarm: a module a pattern, measured over seeds."""
