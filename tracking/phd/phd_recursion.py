"""The recursion of a Gaussian-mixture PHD filter: the text's for extended targets, Vo and Ma's for points."""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from tracking.mixture.components import Components
from tracking.mixture.phd_config import PhdConfig
from tracking.mixture.phd_models import (
    ConstantVelocityMotion,
    Detection,
    Labels,
    OneReturn,
    PoissonCount,
    PositionMeasurement,
    detect,
)
from tracking.mixture.reduction import Reducer
from tracking.mixture.target import Extractor, Target
from tracking.phd.correction import Corrector
from tracking.phd.partitioning import Partitioner, Singletons, make_partitioner
from tracking.phd.partitions import PredictedTargets

# Label weight from which a target is expected to show: below extraction, so that a weak one can recover.
EXPECTED = 0.3

State = tuple[Components, int]


class PhdRecursion:
    """Prediction, partitioning, correction, reduction and extraction of an intensity; each part can be replaced."""

    def __init__(self, config: PhdConfig, detection: Detection, points: bool = False) -> None:
        """`points` for targets that give one return at most."""
        self.motion = ConstantVelocityMotion(config)
        self.measurement = PositionMeasurement(config)
        self.detection = detection
        self.partitioner: Partitioner = Singletons() if points else make_partitioner(config)
        returns = OneReturn() if points else PoissonCount(config)
        self.corrector = Corrector(config, self.measurement, returns)
        self.labels = Labels()
        self.reducer = Reducer(config, self.labels)
        self.extractor = Extractor(config)
        self.components = Components.empty()

    @property
    def expected_count(self) -> float:
        """The integral of the intensity."""
        return float(self.components.weights.sum())

    @property
    def repaired(self) -> int:
        """Times covariances lost definiteness."""
        return self.reducer.repaired

    @property
    def thinned(self) -> int:
        """Groups of returns with more partitions than are weighed."""
        return self.partitioner.thinned

    def reset(self) -> None:
        """Forgets all targets; labels go on counting."""
        self.components = Components.empty()

    def state(self) -> State:
        """What `restore` takes; valid as long as nobody changes the arrays."""
        return self.components, self.labels.next

    def restore(self, state: State) -> None:
        """Back to an earlier state."""
        self.components, self.labels.next = state

    def update(self, points: FloatArray, dt: float, pose: FloatArray | None) -> None:
        """One scan (N, 2), dt seconds after the last."""
        predicted = self.motion.predict(self.components, dt, self.labels)
        partitions = self.partitioner.partition(points, self._expected(predicted))
        hiding = len(self.components) if dt > 0.0 else len(predicted)
        sight = detect(self.detection, predicted, predicted.weights[:hiding], hiding, pose)
        corrected = self.corrector.correct(predicted, sight, points, partitions)
        self.components = self.reducer.reduce(corrected)

    def targets(self) -> list[Target]:
        """Every label of enough weight."""
        return self.extractor.extract(self.components)

    def _expected(self, predicted: Components) -> PredictedTargets:
        """The heaviest component of every label worth expecting."""
        names, name = np.unique(predicted.labels, return_inverse=True)
        if len(names) == 0:
            return PredictedTargets.none()
        totals = np.bincount(name, predicted.weights)
        order = np.lexsort((-predicted.weights, name))
        best = order[np.unique(name[order], return_index=True)[1]][totals >= EXPECTED]
        H = self.measurement.H
        return PredictedTargets(predicted.means[best] @ H.T, H @ predicted.covariances[best] @ H.T)
