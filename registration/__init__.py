"""Scans and clouds, odometry, pairwise and global registration, what moves. Knows no ROS."""

from registration.laser.scan import Scan
from registration.odometry.follower import Odometry
from registration.odometry.odometry_config import OdometryConfig
from registration.placement.align import align
from registration.placement.align_globally import align_globally
from registration.result import Registration

__all__ = ["Odometry", "OdometryConfig", "Registration", "Scan", "align", "align_globally"]
