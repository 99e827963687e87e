"""Saved intentions that are not as they were written: each ends in one sentence."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimation.errors import InputError
from tracking.intentions import IntentionModel
from tracking.intentions.intention_storage import is_saved_model


def taught() -> IntentionModel:
    model = IntentionModel()
    times = np.arange(0.0, 8.0, 0.2)
    for shift in (0.0, 0.1, 0.2):
        model.learn(np.column_stack([times, np.full_like(times, shift), times]))
    return model


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    path = tmp_path_factory.mktemp("saved") / "hall.npz"
    taught().save(path, "hall")
    assert is_saved_model(path)
    assert IntentionModel.load(path, "hall").learned == 3
    with np.load(path) as content:
        return {name: content[name] for name in content.files}


def header(**changes: Any) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda arrays: {
        **arrays,
        "header": np.array(json.dumps(json.loads(str(arrays["header"])) | changes)),
    }


def infinite(name: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda arrays: {**arrays, name: np.full_like(arrays[name], 1e30)}


CHANGES: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "another kind": header(format="whereabouts.map"),
    "another version": header(version=9),
    "settings that there are none of": header(config={"speed": 1}),
    "settings in words": header(config="fast"),
    "no map": lambda arrays: {
        **arrays,
        "header": np.array('{"format": "whereabouts.intentions", "version": 1}'),
    },
    "no description": lambda arrays: {**arrays, "header": np.array("[]")},
    "routes far away": infinite("routes_points"),
    "routes missing": lambda arrays: {k: v for k, v in arrays.items() if k != "routes_points"},
    "bounds elsewhere": lambda arrays: {**arrays, "routes_bounds": arrays["routes_bounds"] + 5},
    "errors that are none": infinite("errors_squares"),
    "errors of half the people": lambda arrays: {**arrays, "errors_walks": arrays["errors_walks"][:1]},
    "bounds empty": lambda arrays: {**arrays, "routes_bounds": np.zeros(0, np.int64)},
}


@pytest.mark.parametrize("kind", CHANGES)
def test_a_malformed_file_ends_in_one_sentence(saved: dict[str, Any], tmp_path: Path, kind: str) -> None:
    path, file = tmp_path / "hall.npz", io.BytesIO()
    np.savez(file, **CHANGES[kind](saved))
    path.write_bytes(file.getvalue())
    with pytest.raises(InputError) as caught:
        IntentionModel.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_file_from_before_errors_were_learned_is_read(saved: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "hall.npz"
    with path.open("wb") as file:
        np.savez(file, **{name: array for name, array in saved.items() if not name.startswith("errors_")})
    model = IntentionModel.load(path, "hall")
    assert model.learned == 3
    np.testing.assert_allclose(model.errors.rates(True, np.array([1.0, 5.0])), [[0.12, 0.1]] * 2)


def test_what_is_no_archive_is_no_model(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    path.write_text("ssh-ed25519 AAAA")
    assert not is_saved_model(path)
    with pytest.raises(InputError, match="is no saved intention model"):
        IntentionModel.load(path)
