"""A sensor followed from scan to scan."""
