"""Place features, the loop-closure classifier, candidate retrieval, pose graph and map. Knows no ROS."""
