"""Gaussians, motion, Kalman filters and the assignment of measurements."""
