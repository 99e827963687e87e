"""Scans and clouds, odometry, pairwise and global registration, the joint CRF. Knows no ROS."""

from registration.odometry import Odometry, OdometryConfig
from registration.scan import Scan

__all__ = ["Odometry", "OdometryConfig", "Scan"]
