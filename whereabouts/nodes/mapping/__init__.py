"""Parts of the node `loop_closure`: its map as it is made, edited, sent and kept, and where odometry comes from."""
