"""Anchors, hypotheses, memory, maintenance and object search. Knows no ROS."""
