"""Learned intentions on disk: one npz file with a header that says what it is, written whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimation.archive import header_of, read_archive
from estimation.errors import InputError
from tracking.intentions.intention_config import IntentionConfig

if TYPE_CHECKING:
    from tracking.intentions.intention_model import IntentionModel

FORMAT = "whereabouts.intentions"
VERSION = 1
LARGEST = 1e12


def save(model: IntentionModel, path: Path, map_id: str) -> Path:
    """Write a model; `map_id` names the map its frame belongs to. Returns the path.

    Raises InputError: the folder does not exist or may not be written.
    """
    header = {
        "format": FORMAT,
        "version": VERSION,
        "map_id": map_id,
        "learned": model.learned,
        "config": asdict(model.config),
    }
    arrays: dict[str, Any] = {"header": np.array(json.dumps(header))}
    for prefix, part in _parts(model).items():
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


def load(path: Path, map_id: str | None) -> IntentionModel:
    """Read a model written by `save`."""
    from tracking.intentions.intention_model import IntentionModel

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
    try:
        _check_magnitudes(arrays)
        model = IntentionModel.of(IntentionConfig(**header["config"]))
        model.learned = int(header["learned"])
        for prefix, part in _parts(model).items():
            part.from_arrays({n.removeprefix(prefix): a for n, a in arrays.items() if n.startswith(prefix)})
    except (KeyError, TypeError, ValueError, IndexError, ArithmeticError, AttributeError) as error:
        raise InputError(f"{path}: is damaged or incomplete ({error})") from error
    return model


def _parts(model: IntentionModel) -> dict[str, Any]:
    """What is stored, by the beginnings of its arrays' names; the states of `hmm` need its map."""
    return {"places_": model.hmm.places, "hmm_": model.hmm, "routes_": model.routes, "errors_": model.errors}


def is_saved_model(path: Path) -> bool:
    """Whether a file says of itself that `save` wrote it."""
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
