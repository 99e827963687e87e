"""The trained models that come with the package; `docs/loop_closure_models.md` says on what and how good."""

from __future__ import annotations

from functools import cache
from importlib.resources import as_file, files

from estimation.errors import InputError
from loop_closure.places.place_model import PlaceModel

NAMES = ("plain_2d", "best_2d", "plain_3d", "best_3d")


@cache
def shipped_model(name: str) -> PlaceModel:
    """One of NAMES: the text's plain method or the best there is, for scans or clouds. InputError for another name."""
    if name not in NAMES:
        raise InputError(f"name: one of {', '.join(NAMES)} expected, got {name!r}")
    with as_file(files("loop_closure.places").joinpath("models", f"{name}.json")) as path:
        return PlaceModel.load(path)
