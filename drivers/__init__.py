"""Drivers: the only code that knows its robot."""
