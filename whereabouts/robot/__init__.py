"""What a robot offers the suite, what stands in the way, and the parameter file that follows. Needs no ROS."""
