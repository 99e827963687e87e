"""Data association, moving objects and their motions between two scans; the reference's joint CRF: `as_printed`."""

from registration.crf.estimate import JointEstimate
from registration.crf.joint_model import JointModel

__all__ = ["JointEstimate", "JointModel"]
