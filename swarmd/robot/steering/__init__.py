"""Steering: asks a command in place of a request that leads nowhere. Pure; protection judges it."""
