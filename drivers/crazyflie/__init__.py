"""Driver `crazyflie`: a quadcopter at one height, by the maker's library cflib."""
