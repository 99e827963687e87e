"""Simulated worlds, laser scanners, people and objects, all seeded."""
