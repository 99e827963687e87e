"""Scans and clouds, odometry, pairwise and global registration, what moves. Knows no ROS."""

from registration.align import align
from registration.align_globally import align_globally
from registration.odometry import Odometry, OdometryConfig
from registration.result import Registration
from registration.scan import Scan

__all__ = ["Odometry", "OdometryConfig", "Registration", "Scan", "align", "align_globally"]
