"""People and whatever else stands free in laser scans: the measurement model `clusters`."""
