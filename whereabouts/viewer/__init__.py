"""What `whereabouts view` shows: messages of the suite as plain shapes, and what draws them. Needs no ROS."""
