"""Readers and writers of robot logs. Knows no ROS installation."""
