"""What a robot offers the suite, what stands in the way, and the parameter file that follows. Needs no ROS."""

from whereabouts.robot.survey import Edge, Seen, Survey

__all__ = ["Edge", "Seen", "Survey"]
