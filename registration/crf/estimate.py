"""What is said of two scans."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray
from estimation.errors import InputError
from registration.result import UNKNOWN

Model = TypeVar("Model")


@dataclass(frozen=True, eq=False)
class JointEstimate:
    """Labelling of scan_a, one entry per beam of it, and the motions of what it sees.

    associations : (N,) beam of scan_b that sees the same spot; -1 for an outlier and for a beam without return.
    clusters : (N,) 0 background, 1.. objects that move, -1 outlier or no return. A beam that certainly left with an
        object but has no partner in scan_b is in the object's cluster with association -1.
    motions : (D, 3) x, y, yaw that take points of scan_a to where they are in the frame of scan_b: row 0 for the
        background (the pose of sensor a in the frame of b), row k for cluster k. An object without counterpart
        in scan_b has the background's row and a large covariance.
    log_score : log probability of the labelling: of every return that it moves, or not, as labelled; by the text's
        model of all states, unnormalised. 0 where there was nothing to infer.
    covariances : (D, 3, 3) of the motions, m² and rad².
    probabilities : (N,) that each beam hit something that moves, in [0, 1]; NaN without return
        and where nothing is known.
    converged : False where the scans have too little in common: everything is then an outlier, and the motion zero.
    reason : one sentence where it did not converge, else empty.
    """

    associations: NDArray[np.int64]
    clusters: NDArray[np.int64]
    motions: FloatArray
    log_score: float
    covariances: FloatArray
    probabilities: FloatArray
    converged: bool = True
    reason: str = ""

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(N,) beams on something that moves."""
        return self.clusters > 0


def read_model(
    path: str | Path | None, shipped: str, kind: str, version: int, made_of: Callable[[dict[str, Any]], Model]
) -> Model:
    """What is `made_of` a model's JSON file, the `shipped` one without a path; InputError if it is of another kind."""
    file = resources.files("registration.crf").joinpath("models", shipped) if path is None else Path(path)
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        if (content["format"], content["version"]) != (kind, version):
            raise InputError(f"path: {path} holds no {kind} model of version {version}")
        return made_of(content)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"path: {path} is no complete {kind} model: {error}") from error


def nothing(beams: int, reason: str) -> JointEstimate:
    """The answer where nothing can be inferred: no motion, all outliers."""
    outliers = np.full(beams, -1, dtype=np.int64)
    unsure = np.full(beams, np.nan)
    return JointEstimate(
        outliers, outliers.copy(), np.zeros((1, 3)), 0.0, UNKNOWN[None], unsure, False, reason
    )


def unchanged(valid: NDArray[np.bool_]) -> JointEstimate:
    """The answer for a scan and itself: every return, (N,), is its own partner and nothing moves."""
    associations = np.where(valid, np.arange(len(valid)), -1)
    clusters = np.where(valid, 0, -1)
    covariance = np.diag([1e-6, 1e-6, 1e-8])
    probabilities = np.where(valid, 0.0, np.nan)
    return JointEstimate(associations, clusters, np.zeros((1, 3)), 0.0, covariance[None], probabilities)
