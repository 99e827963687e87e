"""Registration and odometry of clouds, on small_gicp, KISS-ICP, KISS-Matcher and NDT."""
