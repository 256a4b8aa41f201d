"""The verbs that stop robots and let them move again: stop, estop and reset."""
