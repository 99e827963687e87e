"""Recorded clouds of the registration experiment, read in place."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def read_ply(path: Path) -> NDArray[np.float64]:
    """Points (N, 3) metres of a binary little-endian PLY whose vertices are floats, x, y, z first."""
    content = path.read_bytes()
    end = content.index(b"end_header\n") + len(b"end_header\n")
    header = content[:end].decode().splitlines()
    count = next(int(line.split()[-1]) for line in header if line.startswith("element vertex"))
    fields = sum(line.startswith("property float") for line in header)
    values = np.frombuffer(content[end:], dtype="<f4", count=count * fields).reshape(count, fields)
    return values[:, :3].astype(np.float64)


def read_3dtk(path: Path, max_range: float = 32.0) -> NDArray[np.float64]:
    """Points (N, 3) metres, z up, of a 3DTK scan: centimetres and left-handed (x right, y up, z ahead) in the file."""
    with gzip.open(path, "rt") as lines:
        raw = 0.01 * np.loadtxt(lines)
    raw = raw[np.linalg.norm(raw, axis=1) < max_range]
    return np.column_stack((raw[:, 2], -raw[:, 0], raw[:, 1]))
