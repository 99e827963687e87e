"""What a robot offers the suite, what stands in the way, and the parameter file that follows. Needs no ROS."""

from whereabouts.robot.survey import FrameEdge, Seen, Survey

__all__ = ["FrameEdge", "Seen", "Survey"]
