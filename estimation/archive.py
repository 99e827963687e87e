"""NumPy archives (.npz) from anywhere: read with limits, so that a file can neither run code nor fill the memory."""

from __future__ import annotations

import json
import lzma
import math
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from estimation.errors import InputError

UNPACKED_LIMIT = 2 << 30  # Bytes of all arrays of an archive
MEMBERS = 100
KINDS = "biufU"
_ERRORS = (
    *(OSError, EOFError, LookupError, ValueError, TypeError, OverflowError, MemoryError, RuntimeError),
    *(struct.error, zlib.error, lzma.LZMAError, zipfile.BadZipFile, SyntaxError, tokenize.TokenError),
)


def read_archive(path: Path | str, limit: int = UNPACKED_LIMIT) -> dict[str, NDArray[Any]]:
    """All arrays of an archive; numbers and text only.

    Raises InputError: the file is missing, is no such archive, is damaged, or unpacks to more than `limit` bytes.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            infos = archive.infolist()
            if len(infos) > MEMBERS:
                raise InputError(f"{len(infos)} members, {MEMBERS} is the limit")
            if sum(info.file_size for info in infos) > limit:
                raise InputError(f"unpacks to more than {limit} bytes, the limit")
            arrays = {}
            for info in infos:
                with archive.open(info) as member:
                    arrays[info.filename.removesuffix(".npy")] = _array(member, info.file_size)  # type: ignore[arg-type]
            return arrays
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except _ERRORS as error:
        raise InputError(f"{path}: is not an archive that can be read ({_sentence(error)})") from error


def _array(member: BinaryIO, size: int) -> NDArray[Any]:
    version = npy.read_magic(member)
    read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(version)
    if read is None:
        raise ValueError(f"array format {version} is not known")
    shape, fortran, dtype = read(member)
    if dtype.kind not in KINDS:
        raise ValueError(f"numbers or text expected, got {dtype}")
    count = math.prod(shape)
    if count < 0 or count * dtype.itemsize != size - member.tell():
        raise ValueError("an array has another size than it says")
    data = member.read()
    # To the end of the member, so that its checksum is compared.
    array = np.frombuffer(data, dtype, count).reshape(shape, order="F" if fortran else "C")
    return array.copy()


def header_of(arrays: dict[str, NDArray[Any]], name: str) -> dict[str, Any]:
    """The JSON object that an archive describes itself by. Raises ValueError."""
    try:
        found = json.loads(str(arrays[name]))
    except (KeyError, RecursionError) as error:
        raise ValueError(f"{name} is missing or no description") from error
    if not isinstance(found, dict):
        raise ValueError(f"{name} is no description")
    return found


def _sentence(error: BaseException) -> str:
    text = str(error).splitlines()
    return text[0] if text and text[0] else type(error).__name__
