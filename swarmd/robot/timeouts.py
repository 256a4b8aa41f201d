"""The timeouts, periods and tolerances of a robot, in s."""

LOAD_TIMEOUT = 3.0  # the longest time of the load of a pattern
STEP_TIMEOUT = 1.0  # the longest time of a step; a host without an answer is ended
MIN_EXPIRY = 0.3  # the least time for which a requested command is valid
FAULT_WINDOW = 60.0  # faults within this time count towards the quarantine
FAULTS_BEFORE_QUARANTINE = 4  # a count: the fault that ends the run
FIRST_BACKOFF = 0.1  # the pause before the first restart of a pattern; doubles with each fault
STEP_TOLERANCE = 1e-3  # a step may begin this much early, so that it begins at a tick
ROUNDING = 1e-6  # tolerance of deadlines for rounding of floats
MAX_HOLD_TIME = 2.0  # a hold that lasts this long ends the run
STATUS_PERIOD = 1.0  # the period of statuses while nothing changes
ODOMETRY_TIMEOUT = 0.5  # the age at which odometry is stale
NEIGHBOR_TIMEOUT = 3.0  # without an update for this time the robot has no neighbours
# The period of updates of neighbours' ages, which take long for 1000 neighbours.
AGE_UPDATE_PERIOD = 0.5
KIN_TIMEOUT = 5.0  # since this robot or a peer needed the places of peers: kin ends
