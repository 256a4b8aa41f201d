"""One robot without I/O: lifecycle, sensors, requests and status. Time is an argument."""
