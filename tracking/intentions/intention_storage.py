"""Learned intentions on disk: one npz file with a header that says what it is, written whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estimation.archive import header_of, read_archive
from estimation.errors import InputError

FORMAT = "whereabouts.intentions"
VERSION = 1
LARGEST = 1e12


def write(path: Path, about: Mapping[str, Any], parts: Mapping[str, Any]) -> Path:
    """Write what is said `about` a model, and arrays of its parts by the beginnings of their names. Returns the path.

    Raises InputError: the folder does not exist or may not be written.
    """
    header = {"format": FORMAT, "version": VERSION, **about}
    arrays: dict[str, Any] = {"header": np.array(json.dumps(header))}
    for prefix, part in parts.items():
        arrays |= {f"{prefix}{name}": value for name, value in part.as_arrays().items()}
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error
    try:
        with os.fdopen(handle, "wb") as stream:
            np.savez_compressed(stream, **arrays)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error
    finally:
        Path(temporary).unlink(missing_ok=True)
    return path


@dataclass(frozen=True)
class StoredModel:
    """What a file holds: what is said `about` the model, and arrays by name."""

    path: Path
    about: dict[str, Any]
    arrays: dict[str, Any]

    def part(self, prefix: str) -> dict[str, Any]:
        """Arrays whose names begin so, without that beginning."""
        return {n.removeprefix(prefix): a for n, a in self.arrays.items() if n.startswith(prefix)}

    @contextmanager
    def filling(self) -> Iterator[None]:
        """While a model is filled. Raises InputError where what was read does not fit it."""
        try:
            _check_magnitudes(self.arrays)
            yield
        except (KeyError, TypeError, ValueError, IndexError, ArithmeticError, AttributeError) as error:
            raise InputError(f"{self.path}: is damaged or incomplete ({error})") from error


def read(path: Path, map_id: str | None) -> StoredModel:
    """Read what `write` wrote; with `map_id` it must be of that map.

    Raises InputError: no such file, not a saved model, of another version or map, or damaged.
    """
    try:
        arrays = read_archive(path)
        header = header_of(arrays, "header")
        arrays.pop("header")
        kind, version, learned_in = header["format"], header["version"], header["map_id"]
    except (ValueError, KeyError) as error:
        reason = str(error).removeprefix(f"{path}: ")
        if not path.is_file():
            raise InputError(f"{path}: there is no such file") from error
        raise InputError(f"{path}: is no saved intention model, or is damaged ({reason})") from error
    if kind != FORMAT:
        raise InputError(f"{path}: holds {kind!r}, not {FORMAT!r}")
    if version != VERSION:
        raise InputError(f"{path}: has version {version}; this program reads version {VERSION}: learn anew")
    if map_id is not None and learned_in != map_id:
        raise InputError(f"{path}: was learned in map {learned_in!r}, not {map_id!r}")
    return StoredModel(path, header, arrays)


def is_saved_model(path: Path) -> bool:
    """Whether a file says of itself that `write` wrote it."""
    try:
        return bool(header_of(read_archive(path), "header").get("format") == FORMAT)
    except ValueError:
        return False


def _check_magnitudes(arrays: dict[str, Any]) -> None:
    for name, values in arrays.items():
        if values.dtype.kind != "f":
            continue
        # Where something is not known an infinity stands; what is a number is metres, seconds or a count.
        if np.isnan(values).any() or (np.abs(values[np.isfinite(values)]) > LARGEST).any():
            raise ValueError(f"{name}: numbers up to {LARGEST:g} expected")
