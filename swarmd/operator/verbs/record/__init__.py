"""The recordings of robots: `swarmctl record`."""
