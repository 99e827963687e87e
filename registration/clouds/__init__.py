"""Registration of clouds, on small_gicp, KISS-Matcher and NDT."""
