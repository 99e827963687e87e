"""Extended-target PHD filters, people in laser scans, motion prediction. Knows no ROS."""

from tracking.mixture.phd_config import PhdConfig
from tracking.mixture.target import Target
from tracking.people.people_config import PeopleConfig
from tracking.people.people_tracker import PeopleTracker, Person
from tracking.people.scan_filters import PointsTracker, tracker_of
from tracking.phd.filters import ExtendedTargetPhd, PhdHealth, PointTargetPhd

__all__ = [
    "ExtendedTargetPhd", "PeopleConfig", "PeopleTracker", "Person", "PhdConfig", "PhdHealth",
    "PointTargetPhd", "PointsTracker", "Target", "tracker_of",
]  # fmt: skip
