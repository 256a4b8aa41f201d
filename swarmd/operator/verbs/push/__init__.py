"""Patterns that robots have by the network: `swarmctl plugin push`, `remove` and `list`."""
