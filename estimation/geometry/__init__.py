"""Poses, rotations, polygons, grids and what a planar scan sees."""
