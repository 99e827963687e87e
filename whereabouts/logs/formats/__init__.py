"""Text formats of recordings and trajectories."""
