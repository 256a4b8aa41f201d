"""What a daemon is told before it starts: swarm files, platforms, settings."""
