"""What is kept: the store of changes, and the routines learned from it."""
