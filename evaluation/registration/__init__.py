"""Parts of the experiments `registration` and `odometry`."""
