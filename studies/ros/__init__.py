"""Three robots on DDS behind one bridge, and the faults that are injected: `make ros-study`."""
