"""What a moving sensor gets wrong, learned from what it says about resting objects."""
