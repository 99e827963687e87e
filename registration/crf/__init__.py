"""The joint CRF: data association, moving objects and their motions between two scans in one inference."""

from registration.crf.estimate import JointEstimate
from registration.crf.model import JointModel

__all__ = ["JointEstimate", "JointModel"]
