"""Pruning, merging and capping of the intensity: Table II of Vo and Ma (2006), with labels kept apart."""

from __future__ import annotations

import numpy as np
from numba import njit

from estimation.checks import FloatArray
from estimation.filters.assignment import cheapest
from estimation.filters.gaussians import repair_covariance
from tracking.mixture.components import Components, IntArray
from tracking.mixture.phd_config import PhdConfig
from tracking.mixture.phd_models import Labels

# A component of this much weight is a target of its own, which no other such component may swallow.
ESTABLISHED = 0.5
# Components of at least this weight are told apart by their labels.
DISTINCT = 0.3


@njit(cache=True)
def _clusters(
    weights: FloatArray, means: FloatArray, inverses: FloatArray, limit: float, established: float
) -> IntArray:
    """Index (J,) of the heaviest component each is merged into; components come heaviest first.

    Those of the weight `established` or more are merged into none.
    """
    leader = np.full(len(means), -1)
    for i in range(len(means)):
        if leader[i] >= 0:
            continue
        leader[i] = i
        for j in range(i + 1, len(means)):
            if leader[j] >= 0 or weights[j] >= established:
                continue
            square = 0.0
            for a in range(4):
                for b in range(4):
                    square += (means[j, a] - means[i, a]) * inverses[j, a, b] * (means[j, b] - means[i, b])
            if square <= limit:
                leader[j] = i
    return leader


def distinct_labels(weights: FloatArray, evidence: FloatArray, names: IntArray, labels: Labels) -> IntArray:
    """One label (J,) per component from the weight (J, L) it has from components of each of the L labels `names`.

    Components heavy enough to be targets get different labels, so that as much weight as possible keeps its label;
    one that shares its only label with a heavier target gets a new one. The others keep their most frequent.
    """
    chosen = names[evidence.argmax(1)]
    heavy = np.flatnonzero(weights >= DISTINCT)
    rows, columns = cheapest(-evidence[heavy])
    taken = np.full(len(heavy), -1)
    taken[rows] = columns
    for i, column in zip(heavy, taken, strict=True):
        known = column >= 0 and evidence[i, column] > 0
        chosen[i] = names[column] if known else labels.take(1)[0]
    return chosen


def sound(covariances: FloatArray) -> tuple[FloatArray, bool]:
    """Covariances (J, n, n) made symmetric and, where rounding took that from them, definite again; and whether."""
    covariances = 0.5 * (covariances + np.swapaxes(covariances, 1, 2))
    try:
        np.linalg.cholesky(covariances)
        return covariances, False
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(covariances)
        floor = np.maximum(values[:, -1:], 1e-12) * 1e-12
        raised = (vectors * np.maximum(values, floor)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
        return repair_covariance(0.5 * (raised + np.swapaxes(raised, 1, 2))), True


class Reducer:
    """Keeps the intensity small."""

    def __init__(self, config: PhdConfig, labels: Labels) -> None:
        self.config, self.labels = config, labels
        self.repaired = 0

    def reduce(self, components: Components) -> Components:
        """Fewer components of nearly the same intensity, heaviest first."""
        components = components.select(components.weights > self.config.prune_weight)
        components.covariances, repaired = sound(components.covariances)
        self.repaired += repaired
        components = components.select(np.argsort(-components.weights, kind="stable"))
        if len(components) == 0:
            return components
        merged = self._merged(components)
        order = np.argsort(-merged.weights, kind="stable")[: self.config.max_components]
        return merged.select(order)

    def _merged(self, components: Components) -> Components:
        """Components within the merging distance of a heavier one, joined with their moments kept."""
        inverses: FloatArray = np.linalg.inv(components.covariances).astype(np.float64)
        limit = float(self.config.merge_distance)
        established = np.inf if self.config.merge_targets else ESTABLISHED
        leader = _clusters(components.weights, components.means, inverses, limit, established)
        leaders, member = np.unique(leader, return_inverse=True)
        weights: FloatArray = np.bincount(member, components.weights).astype(np.float64)
        share = components.weights / weights[member]

        def mean_of(values: FloatArray, share: FloatArray = share) -> FloatArray:
            total = np.zeros((len(leaders), *values.shape[1:]))
            np.add.at(total, member, share.reshape(-1, *(1,) * (values.ndim - 1)) * values)
            return total

        names, name = np.unique(components.labels, return_inverse=True)
        evidence = np.zeros((len(leaders), len(names)))
        np.add.at(evidence, (member, name), components.weights)
        chosen = distinct_labels(weights, evidence, names, self.labels)
        # Births and splits that merge into a target know nothing of its rate and extent: its own components tell.
        own = np.where(components.labels == chosen[member], components.weights, 0.0)
        totals: FloatArray = np.bincount(member, own).astype(np.float64)
        known = totals[member] > 0
        own = np.where(known, own / np.where(known, totals[member], 1.0), share)
        means = mean_of(components.means)
        offsets = components.means - means[member]
        covariances = mean_of(components.covariances + offsets[:, :, None] * offsets[:, None, :])
        return Components(
            weights,
            means,
            covariances,
            chosen,
            mean_of(components.counts, own),
            mean_of(components.spread, own),
            mean_of(components.freedom, own),
        )
