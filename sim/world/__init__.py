"""The simulated world: bodies, arenas, sensors, radio; for live daemons and laboratory alike."""
