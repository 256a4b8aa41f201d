"""Configuration of a daemon: swarm files, platforms, driver options."""
