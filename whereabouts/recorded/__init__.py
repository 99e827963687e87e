"""Recorded logs through the libraries, without ROS: odometry, maps, people, worlds."""
