"""Extended-target PHD filters, people in laser scans, motion prediction. Knows no ROS."""

from tracking.people import PeopleTracker, Person
from tracking.people_config import PeopleConfig
from tracking.phd import ExtendedTargetPhd, PhdHealth, PointTargetPhd
from tracking.phd_config import PhdConfig
from tracking.scan_filters import PointsTracker, tracker_of
from tracking.target import Target

__all__ = [
    "ExtendedTargetPhd",
    "PeopleConfig",
    "PeopleTracker",
    "Person",
    "PhdConfig",
    "PhdHealth",
    "PointTargetPhd",
    "PointsTracker",
    "Target",
    "tracker_of",
]
