"""Compiled loops of anchoring over leaves, and the arrays that they share."""
