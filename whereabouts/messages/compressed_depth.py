"""Depth images as image_transport compresses them: a PNG or RVL, and for depths in m how they were made whole numbers.

`compressedDepth` has twelve bytes before the PNG; `compressed` has none. RVL has width and height behind these bytes.
RVL: A. Wilson, "Fast Lossless Depth Image Compression", ISS 2017.
"""

from __future__ import annotations

import io
import struct
import warnings
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit
from PIL import Image

from estimation.errors import InputError
from world_model.camera.depth import ENCODINGS, DepthImage

HEAD = struct.Struct("<iff")
"""Which way of packing, and the two numbers A and B of depth = A / (pixel - B)."""
SIZE = struct.Struct("<II")
PNG = b"\x89PNG"
LONGEST = 30  # bits before the last three of a number of RVL
MOST = 1 << 24  # pixels of an image of RVL, of which a few bytes may promise any number
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
    if data[begin:].startswith(PNG):
        pixels = _pixels(data[begin:])
    elif str(message.format).strip().endswith("rvl"):
        pixels = _unpacked(data[begin:])
    else:
        raise InputError(f"data: a PNG or RVL expected, got {str(message.format)[:60]!r}")
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


def _unpacked(data: bytes) -> Any:
    """(H, W) whole numbers of 16 bits from RVL. Raises InputError."""
    width, height = SIZE.unpack_from(data) if len(data) >= SIZE.size else (0, 0)
    if not 0 < width * height <= MOST:
        raise InputError(f"data: RVL of {width} x {height} pixels")
    pixels = np.zeros(width * height, np.uint16)
    words = np.frombuffer(data, "<u4", (len(data) - SIZE.size) // 4, SIZE.size)
    if not _unroll(words.astype(np.uint32), pixels):
        raise InputError("data: the RVL cannot be read: it is cut off or damaged")
    return pixels.astype("<u2").reshape(height, width)


@njit(cache=True)
def _unroll(words: npt.NDArray[np.uint32], pixels: npt.NDArray[np.uint16]) -> bool:
    """Fill pixels (N,), which are 0, from words (M,) of RVL; returns whether they are whole.

    In turns there is the number of pixels that are 0, that of those that are not, and of each of these its difference
    to the one before. A number is in nibbles of three bits, the lowest first; the fourth bit says that more follow.
    """
    nibble = pixel = run = depth = 0
    zeros = True
    while pixel < len(pixels):
        number = shift = 0
        more = True
        while more:
            if nibble >= 8 * len(words) or shift > LONGEST:
                return False
            bits = int(words[nibble >> 3]) >> (28 - 4 * (nibble & 7)) & 15
            number |= (bits & 7) << shift
            nibble, shift, more = nibble + 1, shift + 3, bits > 7
        if run:
            depth += (number >> 1) ^ -(number & 1)
            if not 0 <= depth <= 0xFFFF:
                return False
            pixels[pixel] = depth
            pixel, run = pixel + 1, run - 1
        elif zeros:
            pixel, zeros = pixel + number, False
        else:
            run, zeros = number, True
    return pixel == len(pixels) and not run


def warm_up() -> None:
    """Compile what reads RVL, or load it."""
    _unroll(np.zeros(1, np.uint32), np.zeros(1, np.uint16))
