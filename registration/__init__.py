"""Scans and clouds, odometry, pairwise and global registration, the joint CRF. Knows no ROS."""

from registration.scan import Scan

__all__ = ["Scan"]
