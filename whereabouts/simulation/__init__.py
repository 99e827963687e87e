"""Worlds, laser ray casting, people and objects."""

from whereabouts.simulation.lidar import Lidar, SimulatedScan
from whereabouts.simulation.movers import Mover, crowd, outlines, random_mover
from whereabouts.simulation.rays import cast
from whereabouts.simulation.robot import Drive, Wheels
from whereabouts.simulation.rooms import corridor, random_floor, random_room
from whereabouts.simulation.shapes import Shapes, box, circle, joined, polygon

__all__ = [
    "Drive", "Lidar", "Mover", "Shapes", "SimulatedScan", "Wheels", "box", "cast", "circle", "corridor",
    "crowd", "joined", "outlines", "polygon", "random_floor", "random_mover", "random_room",
]  # fmt: skip
