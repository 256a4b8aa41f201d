"""The verb that starts a pattern on robots: at once, at one moment, with canaries, with a lease."""
