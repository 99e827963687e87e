"""ROS messages as plain records, without ROS: what logs and nodes have in common.

Apart from `whereabouts.logs`, so that a node does not load what reads files.
"""
