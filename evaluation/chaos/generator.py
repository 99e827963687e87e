"""Messages of any type with nonsense in them: well-formed for DDS, senseless for a robot, repeatable by seed."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from geometry_msgs.msg import Quaternion
from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import LaserScan, PointCloud2, PointField
from tf2_msgs.msg import TFMessage

from whereabouts.nodes.messages.envelopes import POSITION
from whereabouts.nodes.messages.message_types import message_class
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts_msgs.msg import Attribute, DiscreteDistribution, GaussianDistribution

START = 1_000 * NANOSECONDS
FLOATS = (
    0.0, 1.0, -1.0, 0.5, np.nan, np.inf, -np.inf, 1e30, -1e-30, 1e6, POSITION, -POSITION, 0.999 * POSITION, 3e4,
    5e-324, 1e-9, 1e12, -1e12, 100.0, -100.0, 2.0 * np.pi, 1e19,
)  # fmt: skip
WORDS = (
    "", "map", "odom", "base_link", "laser", "nowhere", "/laser", "cup", "cup-1", "person", "person-1", "room", "class",
    "color", "size", "x" * 300, "größe", "not_found", "a\nb", "person-", "-",
)  # fmt: skip
CLASSES = ("cup", "bowl", "shoe", "person", "other")
LENGTHS = (0, 0, 1, 1, 2, 3, 6, 36, 361)
INTEGERS = re.compile(r"^(u?)int(\d+)$")
LINKS = (("map", "odom"), ("odom", "base_link"), ("base_link", "laser"))
SPREADS = (0.01, 0.3, 3.0, 300.0, 1e5)


class Fuzzer:
    """Makes messages.

    sense : probability that a field holds what a robot would say, so that some messages get far.
    """

    def __init__(self, seed: int, sense: float = 0.9) -> None:
        self.rng = np.random.default_rng(seed)
        self.sense = sense
        self._now = START
        self._frame = ""

    def message(self, message_type: type) -> Any:
        """A message, filled to its last field; each is a tenth of a second after the one before."""
        self._now += NANOSECONDS // 10
        return self._message(message_type, 0)

    def bytes(self, message_type: type) -> bytes:
        """A serialised message with some of its bytes changed, left out or added, or with its end cut off."""
        data = bytearray(serialize_message(self.message(message_type)))
        for _ in range(int(self.rng.integers(1, 6))):
            at = int(self.rng.integers(len(data))) if data else 0
            kind = int(self.rng.integers(5))
            if kind == 0:
                del data[at:]
            elif kind == 1:
                data[at : at + 4] = self.rng.bytes(4)
            elif kind == 2:
                data[at : at + 4] = int(self._pick((0, 1, 2**31 - 1, 2**32 - 1, 65536))).to_bytes(4, "little")
            elif kind == 3:
                data[at:at] = self.rng.bytes(int(self.rng.integers(1, 9)))
            else:
                del data[at : at + int(self.rng.integers(1, 9))]
        return bytes(data)

    def mutated(self, message_type: type) -> Any | None:
        """What the middleware makes of changed bytes; None where it refuses them."""
        try:
            return deserialize_message(self.bytes(message_type), message_type)
        except Exception:
            return None

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
        maker = {
            LaserScan: self._scan, PointCloud2: self._cloud, OccupancyGrid: self._grid, Quaternion: self._turn,
            TFMessage: self._transforms, DiscreteDistribution: self._distribution, Attribute: self._attribute,
        }.get(message_type)  # fmt: skip
        return None if maker is None else maker()

    def _scan(self) -> LaserScan:
        beams = int(self._pick((1, 2, 181, 181, 181, 360, 1081)))
        step = np.pi / max(beams - 1, 1) * float(self._pick((1.0, 1.0, 1.0, -1.0, 2.0, 1e-3)))
        reach = float(self._pick((4.0, 4.0, 4.0, 30.0, 1e4, POSITION)))
        ranges = self.rng.uniform(0.02 * reach, reach, beams).astype(np.float32)
        if not self._sensible():
            ranges[self.rng.random(beams) < 0.3] = self._pick(FLOATS[:8])
        return LaserScan(
            angle_min=-0.5 * step * beams, angle_max=0.5 * step * beams, angle_increment=step, range_min=0.05,
            range_max=float(self._pick((30.0, 30.0, 30.0, 2e6, np.inf))), ranges=ranges.tolist(),
        )  # fmt: skip

    def _cloud(self) -> PointCloud2:
        count = int(self._pick((1, 10, 200)))
        points = self.rng.uniform(-4.0, 4.0, (count, 3)).astype(np.float32)
        if not self._sensible():
            points *= np.float32(self._pick((1e3, 1e6, 1e30)))
        fields = [PointField(name=n, offset=4 * k, datatype=7, count=1) for k, n in enumerate("xyz")]
        return PointCloud2(
            height=1, width=count, fields=fields, point_step=12, row_step=12 * count, data=points.tobytes(),
            is_dense=True,
        )  # fmt: skip

    def _grid(self) -> OccupancyGrid:
        width, height = (int(self._pick((1, 30, 30, 100))) for _ in range(2))
        grid = OccupancyGrid(data=self.rng.choice([-1, 0, 100], width * height).tolist())
        grid.info.width, grid.info.height, grid.info.resolution = width, height, 0.2
        return grid

    def _distribution(self) -> DiscreteDistribution:
        names = [name for name in CLASSES if self.rng.random() < 0.5]
        shares = self.rng.dirichlet(np.ones(len(names) + 1))[: len(names)]
        return DiscreteDistribution(values=names, probabilities=[float(share) for share in shares])

    def _attribute(self) -> Attribute:
        if self._sensible():
            return Attribute(name="class", discrete=self._distribution())
        size = float(self._pick(FLOATS))
        return Attribute(name="size", continuous=GaussianDistribution(mean=[size], covariance=[abs(size)]))

    def _turn(self) -> Quaternion:
        half_angle = float(self.rng.uniform(-1.5, 1.5))
        return Quaternion(z=float(np.sin(half_angle)), w=float(np.cos(half_angle)))

    def _transforms(self) -> TFMessage:
        """Links of the robot's own tree, near where they were or leaping."""
        links = [LINKS[k] for k in self.rng.integers(0, len(LINKS), int(self.rng.integers(1, 4)))]
        made = []
        for parent, child in links:
            spread = float(self._pick(SPREADS[:3] if self._sensible() else SPREADS))
            half = float(self.rng.normal(0.0, min(spread, 1.5)))
            pose = (*self.rng.normal(0.0, spread, 3), 0.0, 0.0, np.sin(half), np.cos(half))
            made.append(transform_message(parent, child, self._now, pose))
        return TFMessage(transforms=made)

    def _value(self, name: str, kind: str, depth: int) -> Any:
        if fixed := re.match(r"^(.*)\[(\d+)\]$", kind):
            return self._fixed(name, fixed[1], int(fixed[2]), depth)
        if sequence := re.match(r"^sequence<(.*?)(?:, (\d+))?>$", kind):
            plain = "/" not in sequence[1]
            longest = self._pick(LENGTHS) if plain else int(self.rng.integers(0, 4 - min(depth, 3)))
            if plain and self._sensible():
                longest = 2
            return [self._value(name, sequence[1], depth + 1) for _ in range(longest)]
        if kind in ("float", "double", "float32", "float64"):
            return self._float(name)
        if kind == "boolean":
            return bool(self.rng.random() < 0.5)
        if kind == "octet":
            return bytes([int(self.rng.integers(256))])
        if kind.startswith(("string", "wstring")):
            return self._frame if "frame" in name and self._sensible() else self._pick(WORDS)
        if integer := INTEGERS.match(kind):
            return self._integer(not integer[1], int(integer[2]))
        package, message = kind.split("/")
        return self._message(message_class(f"{package}/msg/{message}"), depth + 1)

    def _fixed(self, name: str, kind: str, length: int, depth: int) -> list[Any]:
        side = round(np.sqrt(length))
        if side * side == length and self._sensible():
            root = float(self._pick((1e-6, 0.1, 0.1, 0.1, 10.0, 1e6))) * self.rng.normal(size=(side, side))
            return ((root @ root.T).ravel() if self._sensible() else 0.01 * np.eye(side).ravel()).tolist()
        return [self._value(name, kind, depth) for _ in range(length)]

    def _sensible(self) -> bool:
        return bool(self.rng.random() < self.sense)

    def _pick(self, options: Any) -> Any:
        return options[int(self.rng.integers(len(options)))]

    def _float(self, name: str) -> float:
        if self._sensible():
            share = any(word in name for word in ("probabilit", "score", "w"))
            return 0.5 if share else float(np.float32(self.rng.normal(0.5, 1.0)))
        return float(self._pick(FLOATS))

    def _integer(self, signed: bool, bits: int) -> int:
        low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
        if self._sensible():
            return int(self.rng.integers(0, 5))
        return min(max(int(self._pick((0, 1, low, high, high // 2, 100))), low), high)

    def _stamp(self) -> Any:
        if self._sensible() or self._sensible():
            return time_message(self._now)
        choices = (
            0, 1, START, self._now - NANOSECONDS // 2, self._now + NANOSECONDS, (2**31 - 1) * NANOSECONDS,
        )  # fmt: skip
        return time_message(int(self._pick(choices)))
