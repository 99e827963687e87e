"""What is kept: the store of changes, and routines and habits learned from it."""
