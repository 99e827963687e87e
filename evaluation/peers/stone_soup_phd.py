"""Stone Soup's GM-PHD on the centroids of DBSCAN clusters: what a user of the public library would build."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np

from tracking import PhdConfig

# A cluster: returns closer than this many standard deviations, three at least (clutter alone is dropped so).
NEIGHBOUR, LEAST = 1.75, 3


class StoneSoupPhd:
    """The interface of `ExtendedTargetPhd`, without labels: `step` returns positions (N, 2)."""

    def __init__(self, config: PhdConfig) -> None:
        from stonesoup.hypothesiser.distance import DistanceHypothesiser
        from stonesoup.hypothesiser.gaussianmixture import GaussianMixtureHypothesiser
        from stonesoup.measures import Mahalanobis
        from stonesoup.mixturereducer.gaussianmixture import GaussianMixtureReducer
        from stonesoup.models.measurement.linear import LinearGaussian
        from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
        from stonesoup.predictor.kalman import KalmanPredictor
        from stonesoup.types.array import CovarianceMatrix
        from stonesoup.updater.kalman import KalmanUpdater
        from stonesoup.updater.pointprocess import PHDUpdater

        self.config = config
        noise = config.measurement_noise**2 / max(config.measurement_rate, 1.0)
        self.model = LinearGaussian(4, (0, 2), CovarianceMatrix(noise * np.eye(2)))
        transition = CombinedLinearGaussianTransitionModel([ConstantVelocity(config.process_noise**2)] * 2)
        self.predictor, self.kalman = KalmanPredictor(transition), KalmanUpdater(self.model)
        gates = DistanceHypothesiser(self.predictor, self.kalman, Mahalanobis(), missed_distance=5)
        self.hypothesiser = GaussianMixtureHypothesiser(gates, order_by_detection=True)
        self.updater = PHDUpdater(
            self.kalman,
            clutter_spatial_density=1.0 / config.area,
            prob_detection=config.detection_probability,
            prob_survival=config.survival_probability,
        )
        self.reducer = GaussianMixtureReducer(
            prune_threshold=1e-3, pruning=True, merge_threshold=4, merging=True
        )
        self.start = datetime(2020, 1, 1)
        self.components: set = set()

    @property
    def expected_count(self) -> float:
        """The integral of the intensity."""
        return float(sum(component.weight for component in self.components))

    def step(self, points: np.ndarray, stamp: float) -> np.ndarray:
        """Positions (N, 2) after the scan."""
        from stonesoup.types.detection import Detection
        from stonesoup.types.state import TaggedWeightedGaussianState

        now = self.start + timedelta(seconds=stamp)
        order = [0, 2, 1, 3]  # x, vx, y, vy
        for weight, mean, covariance in self.config.births:
            self.components.add(
                TaggedWeightedGaussianState(
                    mean[order].reshape(4, 1),
                    covariance[np.ix_(order, order)],
                    timestamp=now,
                    weight=weight,
                    tag="birth",
                )
            )
        detections = {
            Detection(centre.reshape(2, 1), timestamp=now, measurement_model=self.model)
            for centre in self._clusters(points)
        }
        hypotheses = self.hypothesiser.hypothesise(self.components, detections, now, order_by_detection=True)
        self.components = set(self.reducer.reduce(self.updater.update(hypotheses)))
        found = [c.mean[[0, 2], 0] for c in self.components if c.weight > 0.5]
        return np.array(found, dtype=float).reshape(-1, 2)

    def _clusters(self, points: np.ndarray) -> list[np.ndarray]:
        from sklearn.cluster import DBSCAN

        if len(points) == 0:
            return []
        names = DBSCAN(eps=NEIGHBOUR * self.config.measurement_noise, min_samples=LEAST).fit_predict(points)
        return [points[names == name].mean(0) for name in range(names.max() + 1)]
