"""The trajectory as a graph of poses: smoothed, filtered, thinned out."""
