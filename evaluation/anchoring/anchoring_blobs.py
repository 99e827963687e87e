"""The blob detector of section 2.6.1: pixels in HSV and a bounding box, grounded by the relations of Table 2.2."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from world_model import ObjectEvidence
from world_model.symbols import Gaussian, Symbols

Array = NDArray[np.float64]

# Table 2.2, in the units of the text's images: hue in [0, 180), saturation and value up to 255, size in metres.
TABLE_2_2 = Symbols(
    {
        "quantities": {
            "hue": {"period": 180},
            "saturation": {"range": [0, 255]},
            "value": {"range": [0, 255]},
            "size": {"range": [0, float("inf")]},
            "ratio": {"range": [0, float("inf")]},
        },
        "predicates": {
            "green": {
                "attribute": "color",
                "where": {"hue": [15, 65], "saturation": [0, 255], "value": [0, 255]},
            },
            "red": {
                "attribute": "color",
                "where": {"hue": [165, 179], "saturation": [128, 223], "value": [80, 159]},
            },
            "small": {"attribute": "size", "where": {"size": [0, 0.15]}},
            "medium": {"attribute": "size", "where": {"size": [0.15, 0.25]}},
            "large": {"attribute": "size", "where": {"size": [0.25, float("inf")]}},
            "rectangle": {"attribute": "shape", "where": {"ratio": [[0, 0.6], [1.4, float("inf")]]}},
            "square": {"attribute": "shape", "where": {"ratio": [0.6, 1.4]}},
        },
    }
)
PERIOD = 180.0
PIXELS = 400  # of a blob
PIXEL_SIGMA = np.array([2.5, 12.0, 10.0])  # of one pixel about its blob's colour
LIGHT_SIGMA = np.array([0.5, 6.0, 8.0])  # of a blob's colour from image to image
EDGE_SIGMA = 0.004  # m, of a blob's width and height
SIGMA = float(np.sqrt(0.0008))  # m, of a position: printed
PRINTED = 0.8  # probability of each measured symbol in the text


@dataclass(frozen=True)
class Blob:
    """One thing on the table: middle (x, y) m, mean colour in HSV, width and height m, speed along x m/s."""

    x: float
    y: float
    hsv: tuple[float, float, float]
    width: float
    height: float
    speed: float = 0.0

    def at(self, x: float, y: float) -> Blob:
        """The same elsewhere, at rest."""
        return replace(self, x=x, y=y, speed=0.0)

    def after(self, seconds: float) -> Blob:
        """The same some time later."""
        return replace(self, x=self.x + self.speed * seconds)


def pixels(rng: np.random.Generator, blob: Blob) -> Array:
    """(PIXELS, 3) HSV of a blob in one image."""
    middle = np.array(blob.hsv) + rng.normal(0.0, LIGHT_SIGMA)
    drawn = middle + rng.normal(0.0, PIXEL_SIGMA, (PIXELS, 3))
    return np.column_stack((drawn[:, 0] % PERIOD, np.clip(drawn[:, 1:], 0.0, 255.0)))


def colour(drawn: Array) -> dict[str, Gaussian]:
    """Mean and variance of pixels (N, 3) in hue, which wraps around, saturation and value."""
    turn = drawn[:, 0] * 2.0 * np.pi / PERIOD
    middle = np.angle(np.exp(1j * turn).mean()) * PERIOD / (2.0 * np.pi)
    off = (drawn[:, 0] - middle + 0.5 * PERIOD) % PERIOD - 0.5 * PERIOD
    found = {"hue": (float((middle + off.mean()) % PERIOD), float(off.var()))}
    for k, name in enumerate(("saturation", "value"), start=1):
        found[name] = (float(drawn[:, k].mean()), float(drawn[:, k].var()))
    return found


def outline(rng: np.random.Generator, blob: Blob) -> dict[str, Gaussian]:
    """Length of the diagonal and ratio of height to width of the bounding box, with variances to first order."""
    width, height = np.array([blob.width, blob.height]) + rng.normal(0.0, EDGE_SIGMA, 2)
    ratio = height / width
    return {
        "size": (float(np.hypot(width, height)), EDGE_SIGMA**2),
        "ratio": (float(ratio), float((EDGE_SIGMA / width) ** 2 * (1.0 + ratio**2))),
    }


def detection(rng: np.random.Generator, blob: Blob, fixed: bool) -> ObjectEvidence:
    """What the detector says of a blob; `fixed`: the likeliest symbols only, with the printed probability."""
    attributes = TABLE_2_2.perceived(colour(pixels(rng, blob)) | outline(rng, blob))
    if fixed:
        for name, values in attributes.items():
            said = max(values, key=lambda value: values[value])
            rest = (1.0 - PRINTED) / (len(values) - 1)
            attributes[name] = {value: PRINTED if value == said else rest for value in values}
    position = np.array([blob.x, blob.y, 0.87]) + rng.normal(0.0, SIGMA, 3)
    return ObjectEvidence(position, SIGMA**2 * np.eye(3), attributes)
