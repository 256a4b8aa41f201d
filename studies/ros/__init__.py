"""Three robots on DDS behind one bridge, and their faults: `make night ARGS=ros_faults`."""
