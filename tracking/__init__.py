"""Extended-target PHD filters, people in laser scans, motion prediction. Knows no ROS."""
