"""A scan as every method sees it: prepared once, surfaces, local maps."""
