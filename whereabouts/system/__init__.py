"""Files that appear whole, clocks, processes, progress."""
