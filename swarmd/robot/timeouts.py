"""How long a robot waits for what, and when it acts again; in s."""

LOAD_TIMEOUT = 3.0  # for a pattern that is being loaded
STEP_TIMEOUT = 1.0  # for the answer to a step; then the host is ended
MIN_EXPIRY = 0.3  # for which a requested command holds at least
FAULT_WINDOW = 60.0  # within which faults count towards the quarantine
FAULTS_BEFORE_QUARANTINE = 4  # faults, of which the last ends the run
FIRST_BACKOFF = 0.1  # before the first restart of a pattern; doubles with each fault
STEP_TOLERANCE = 1e-3  # by which a step may come early, with a tick
ROUNDING = 1e-6  # a deadline must not be missed by the last bit of a float
MAX_HOLD_TIME = 2.0  # after which a hold ends the run
STATUS_PERIOD = 1.0  # between two statuses while nothing changes
ODOMETRY_TIMEOUT = 0.5  # after which odometry is stale
NEIGHBOR_TIMEOUT = 3.0  # without an update after which there are no neighbours
AGE_UPDATE_PERIOD = 0.5  # between updates of the neighbours' ages: a thousand take a while
