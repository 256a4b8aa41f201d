"""The simulated world of live runs and lockstep: robots, arenas, sensors, radio."""
