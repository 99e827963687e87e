"""Poses, distributions, filters, assignment and metrics. Knows no sensor and no ROS."""
