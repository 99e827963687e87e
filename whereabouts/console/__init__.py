"""A page that shows what the suite knows: live, or from a store. The parts import ROS only where they listen to it."""
