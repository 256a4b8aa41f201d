"""How long a robot waits for what, and when it acts again; in s."""

LOAD_TIMEOUT = 3.0
"""For a pattern that is being loaded."""
STEP_TIMEOUT = 1.0
"""For the answer to a step; then the host is ended."""
MIN_EXPIRY = 0.3
"""For which a requested command holds at least."""
FAULT_WINDOW = 60.0
"""Within which faults count towards the quarantine."""
FAULTS_BEFORE_QUARANTINE = 4
"""Faults, of which the last ends the run."""
FIRST_BACKOFF = 0.1
"""Before the first restart of a pattern; doubles with each fault."""
STEP_TOLERANCE = 1e-3
"""By which a step may come early, with a tick."""
ROUNDING = 1e-6
"""A deadline must not be missed by the last bit of a float."""
MAX_HOLD_TIME = 2.0
"""After which a hold ends the run."""
STATUS_PERIOD = 1.0
"""Between two statuses while nothing changes."""
ODOMETRY_TIMEOUT = 0.5
"""After which odometry is stale."""
NEIGHBOR_TIMEOUT = 3.0
"""Without an update after which there are no neighbours."""
AGE_UPDATE_PERIOD = 0.5
"""Between updates of the neighbours' ages: a thousand take a while."""
