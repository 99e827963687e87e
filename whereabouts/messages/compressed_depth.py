"""Depth images as image_transport compresses them: a PNG, and for depths in m how they were made whole numbers.

`compressedDepth` has twelve bytes before the PNG; `compressed` has none.
"""

from __future__ import annotations

import io
import struct
import warnings
from typing import Any

import numpy as np
from PIL import Image

from estimation.errors import InputError
from world_model.camera.depth import ENCODINGS, DepthImage

HEAD = struct.Struct("<iff")
"""Which way of packing, and the two numbers A and B of depth = A / (pixel - B)."""
PNG = b"\x89PNG"
SUFFIXES = ("/compressedDepth", "/compressed")
"""Of topics, as image_transport names them."""


def encoding_of(message: Any) -> str:
    """Of the depth image in a sensor_msgs/CompressedImage, "" where it has none."""
    encoding = str(message.format).partition(";")[0].strip()
    return encoding if encoding in ENCODINGS else ""


def decompressed(message: Any) -> DepthImage:
    """The depth image in a sensor_msgs/CompressedImage. Raises InputError naming the field."""
    encoding, data = encoding_of(message), bytes(message.data)
    if not encoding:
        raise InputError(
            f"format: that of a depth image expected, as '16UC1; compressedDepth png', got {str(message.format)[:60]!r}"
        )
    begin = 0 if data.startswith(PNG) else HEAD.size
    if not data[begin:].startswith(PNG):
        raise InputError(
            f"data: a PNG expected, got {str(message.format)[:60]!r}; other ways of packing (rvl) are not read: "
            "let the camera's driver publish PNG"
        )
    pixels = _pixels(data[begin:])
    if encoding == "32FC1":
        if not begin:
            raise InputError("data: depths in m (32FC1) have no PNG but by compressedDepth")
        _, a, b = HEAD.unpack_from(data)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            metres = np.where(pixels > 0, np.float32(a) / (pixels.astype(np.float32) - np.float32(b)), 0.0)
        pixels = metres.astype("<f4")
    height, width = pixels.shape
    return DepthImage.decoded((width, height), encoding, pixels.tobytes())


def _pixels(png: bytes) -> Any:
    """(H, W) whole numbers of 16 bits. Raises InputError."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
                pixels = np.asarray(image)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Warning) as error:
        raise InputError(f"data: the PNG cannot be read: {error}") from None
    if pixels.ndim != 2 or pixels.dtype.itemsize < 2:
        raise InputError(f"data: one channel of 16 bits expected, got {pixels.dtype} {pixels.shape}")
    return pixels.astype("<u2")
