"""Scenes of the experiments: rooms, streets, crowds, people who hide."""
