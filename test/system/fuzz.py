"""Messages of any type with nonsense in them: well-formed for DDS, senseless for a robot, repeatable by seed."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from geometry_msgs.msg import Quaternion
from harness import START
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import LaserScan, PointCloud2, PointField

from whereabouts.nodes.interfaces import message_class
from whereabouts.nodes.stamps import NANOSECONDS, time_message

FLOATS = (0.0, 1.0, -1.0, 0.5, np.nan, np.inf, -np.inf, 1e30, -1e-30, 1e6)
WORDS = ("", "map", "nowhere", "/laser", "cup", "cup-1", "person", "room", "class", "x" * 300, "größe")
LENGTHS = (0, 0, 1, 1, 2, 3, 6, 36, 361)
INTEGERS = re.compile(r"^(u?)int(\d+)$")


class Fuzzer:
    """Makes messages.

    sense : probability that a field holds what a robot would say, so that some messages get far.
    """

    def __init__(self, seed: int, sense: float = 0.9) -> None:
        self._rng = np.random.default_rng(seed)
        self._sense = sense
        self._now = START
        self._frame = ""

    def message(self, message_type: type) -> Any:
        """A message, filled to its last field; each is a tenth of a second after the one before."""
        self._now += NANOSECONDS // 10
        return self._message(message_type, 0)

    def _message(self, message_type: Any, depth: int) -> Any:
        if message_type.__name__ == "Time":
            return self._stamp()
        if depth == 0:
            self._frame = "laser" if message_type in (LaserScan, PointCloud2) else self._pick(("map", "odom"))
        template = self._template(message_type)
        made = message_type() if template is None else template
        for name, kind in message_type.get_fields_and_field_types().items():
            if template is None or name == "header" or not self._sensible():
                setattr(made, name, self._value(name, kind, depth))
        return made

    def _template(self, message_type: type) -> Any:
        """A sensible message where fields must fit each other."""
        if message_type is LaserScan:
            beams = 181
            step = np.pi / (beams - 1)
            ranges = self._rng.uniform(1.0, 4.0, beams).astype(np.float32).tolist()
            half = float(0.5 * np.pi)
            return LaserScan(
                angle_min=-half,
                angle_max=half,
                angle_increment=float(step),
                range_min=0.05,
                range_max=30.0,
                ranges=ranges,
            )
        if message_type is PointCloud2:
            points = self._rng.uniform(-4.0, 4.0, (200, 3)).astype(np.float32)
            fields = [PointField(name=n, offset=4 * k, datatype=7, count=1) for k, n in enumerate("xyz")]
            return PointCloud2(
                height=1,
                width=200,
                fields=fields,
                point_step=12,
                row_step=2400,
                data=points.tobytes(),
                is_dense=True,
            )
        if message_type is OccupancyGrid:
            grid = OccupancyGrid(data=self._rng.choice([-1, 0, 100], 900).tolist())
            grid.info.width = grid.info.height = 30
            grid.info.resolution = 0.2
            return grid
        if message_type is Quaternion:
            half_angle = float(self._rng.uniform(-1.5, 1.5))
            return Quaternion(z=float(np.sin(half_angle)), w=float(np.cos(half_angle)))
        return None

    def _value(self, name: str, kind: str, depth: int) -> Any:
        if fixed := re.match(r"^(.*)\[(\d+)\]$", kind):
            length = int(fixed[2])
            if length in (9, 36) and self._sensible():
                return (0.01 * np.eye(int(np.sqrt(length)))).ravel().tolist()
            return [self._value(name, fixed[1], depth) for _ in range(length)]
        if sequence := re.match(r"^sequence<(.*?)(?:, (\d+))?>$", kind):
            plain = "/" not in sequence[1]
            longest = self._pick(LENGTHS) if plain else int(self._rng.integers(0, 4 - min(depth, 3)))
            if plain and self._sensible():
                longest = 2
            return [self._value(name, sequence[1], depth + 1) for _ in range(longest)]
        if kind in ("float", "double", "float32", "float64"):
            return self._float(name)
        if kind == "boolean":
            return bool(self._rng.random() < 0.5)
        if kind == "octet":
            return bytes([int(self._rng.integers(256))])
        if kind.startswith(("string", "wstring")):
            return self._frame if "frame" in name and self._sensible() else self._pick(WORDS)
        if integer := INTEGERS.match(kind):
            return self._integer(not integer[1], int(integer[2]))
        package, message = kind.split("/")
        return self._message(message_class(f"{package}/msg/{message}"), depth + 1)

    def _sensible(self) -> bool:
        return bool(self._rng.random() < self._sense)

    def _pick(self, options: Any) -> Any:
        return options[int(self._rng.integers(len(options)))]

    def _float(self, name: str) -> float:
        if self._sensible():
            share = any(word in name for word in ("probabilit", "score", "w"))
            return 0.5 if share else float(np.float32(self._rng.normal(0.5, 1.0)))
        return float(self._pick(FLOATS))

    def _integer(self, signed: bool, bits: int) -> int:
        low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
        if self._sensible():
            return int(self._rng.integers(0, 5))
        return int(self._pick((0, 1, low, high, high // 2)))

    def _stamp(self) -> Any:
        if self._sensible() or self._sensible():
            return time_message(self._now)
        choices = (
            0,
            1,
            START,
            self._now - NANOSECONDS // 2,
            self._now + NANOSECONDS,
            (2**31 - 1) * NANOSECONDS,
        )
        return time_message(int(self._pick(choices)))
