"""How much more a cluster looks like a person's leg, legs or trunk than like anything else.

Boosted trees over the features of `tracking.people.legs`; `evaluation/people/people_training.py` trained them and
`models/people_clusters_card.json` says on what.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from estimation.checks import FloatArray
from estimation.learning.gradient_boosting import GradientBoosting
from tracking.people.legs import Clusters

MODEL = "people_clusters.json"
CARD = "people_clusters_card.json"


@dataclass(frozen=True)
class ShapeModel:
    """Boosted trees over the features of clusters, trained with as much weight on people as on everything else."""

    trees: GradientBoosting

    def evidence(self, clusters: Clusters) -> FloatArray:
        """Log-likelihood ratio person : other of each cluster's shape, (K,)."""
        if not len(clusters):
            return np.zeros(0)
        return self.trees.decision(clusters.features)


@cache
def shape_model() -> ShapeModel:
    """The model of the package."""
    folder = resources.files("tracking.people") / "models"
    with resources.as_file(folder / MODEL) as path:
        return ShapeModel(GradientBoosting.load(path))
