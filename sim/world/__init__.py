"""The simulated world: bodies, arenas, sensors and radio, for live daemons and laboratory alike."""
