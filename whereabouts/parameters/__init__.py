"""Parameters of every node as pydantic models: the one source for ROS, YAML files and the docs."""
