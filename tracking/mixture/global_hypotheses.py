"""Global hypotheses of a multi-Bernoulli mixture, kept in independent groups of targets.

Targets that share no return have nothing to do with each other: every group has its own few hypotheses, and all
combinations of them are implied. Groups are joined (by product) when their targets come near, and divided (by
marginals) when they part, so that the cost is the sum over groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from tracking.mixture.components import Components, IntArray
from tracking.mixture.correction_kernels import States, moments
from tracking.mixture.hypothesis_kernels import merge_plan

# A hypothesis on its own: its log-weight and the rows of its tracks.
Alternative = tuple[float, tuple[int, ...]]


@dataclass
class Hypotheses:
    """H hypotheses over N tracks: hypothesis h of group `group[h]` says that its tracks are all there is.

    Tracks starts[h] to starts[h + 1] belong to h; a track's `weights` is its probability of existence. Hypotheses
    are ordered by group and by falling weight; log_weights are normalised within the group.
    """

    tracks: Components
    starts: IntArray
    log_weights: FloatArray
    group: IntArray

    @classmethod
    def empty(cls) -> Hypotheses:
        """No targets."""
        none = np.zeros(0, dtype=np.int64)
        return cls(Components.empty(), np.zeros(1, dtype=np.int64), np.zeros(0), none)

    def __len__(self) -> int:
        return len(self.group)

    @property
    def track_weights(self) -> FloatArray:
        """Probability (N,) of a track's hypothesis and of its existence in it."""
        weights: FloatArray = np.repeat(np.exp(self.log_weights), np.diff(self.starts)) * self.tracks.weights
        return weights

    @classmethod
    def of(cls, tracks: Components, groups: Sequence[Sequence[Alternative]]) -> Hypotheses:
        """Hypotheses of every group, ordered and normalised; `tracks` are the rows they refer to."""
        rows: list[int] = []
        counts, values, numbers = [0], [], []
        for number, alternatives in enumerate(groups):
            ordered = sorted(alternatives, key=lambda item: -item[0])
            logs = np.array([value for value, _ in ordered])
            values.append(logs - np.logaddexp.reduce(logs))
            for _, members in ordered:
                rows.extend(members)
                counts.append(len(rows))
                numbers.append(number)
        return cls(
            tracks.select(np.array(rows, dtype=np.int64)),
            np.array(counts, dtype=np.int64),
            np.concatenate([np.zeros(0), *values]),
            np.array(numbers, dtype=np.int64),
        )

    def alternatives(self) -> list[list[Alternative]]:
        """The hypotheses by group."""
        groups: list[list[Alternative]] = []
        starts, logs = self.starts.tolist(), self.log_weights.tolist()
        last = -1
        for h, number in enumerate(self.group.tolist()):
            if number != last:
                groups.append([])
                last = number
            groups[-1].append((logs[h], tuple(range(starts[h], starts[h + 1]))))
        return groups

    def arranged(self, place: list[int], most: int) -> dict[int, list[Alternative]]:
        """Alternatives by new group, where track n belongs to new group `place[n]`; `most` per group."""
        factors: dict[int, list[list[Alternative]]] = {}
        for alternatives in self.alternatives():
            places = {place[row] for _, rows in alternatives for row in rows}
            if len(places) == 1:
                factors.setdefault(places.pop(), []).append(alternatives)
                continue
            for where in sorted(places):
                factors.setdefault(where, []).append(self._marginal(alternatives, place, where, most))
        return {where: _product(parts, most) for where, parts in factors.items()}

    def _marginal(
        self, alternatives: list[Alternative], place: list[int], where: int, most: int
    ) -> list[Alternative]:
        """What the alternatives say of the targets in one new group."""
        found: dict[tuple[tuple[int, bytes], ...], tuple[float, tuple[int, ...]]] = {}
        for value, rows in alternatives:
            mine = tuple(row for row in rows if place[row] == where)
            key = tuple((int(self.tracks.labels[row]), self.tracks.means[row].tobytes()) for row in mine)
            if key in found:
                value = float(np.logaddexp(value, found[key][0]))
            found[key] = value, mine
        return sorted(found.values(), key=lambda item: -item[0])[:most]

    def reduced(self, limit: float, margin: float, most: int, least: float) -> Hypotheses:
        """Fewer hypotheses that say nearly the same.

        Those that agree on every target up to `limit` in squared Mahalanobis distance, whatever its label, are merged
        with their moments kept; those `margin` below the best in log-weight, beyond `most`, and tracks less probable
        than `least` go.
        """
        if len(self) == 0:
            return self
        leader, target, labels = merge_plan(
            self.group,
            self.log_weights,
            self.starts,
            self.tracks.labels,
            self.tracks.weights,
            self.tracks.means,
            self.tracks.covariances,
            limit,
        )
        owner = leader[np.repeat(np.arange(len(self)), np.diff(self.starts))]
        weights = np.exp(self.log_weights)
        totals = np.bincount(leader, weights, len(self))
        weight_of = np.where(target >= 0, self.track_weights, 0.0)
        target = np.where(target >= 0, target, np.arange(len(target)))
        tracks = _moments(self.tracks, weight_of, target)
        tracks.labels = labels
        tracks.weights /= np.maximum(totals[owner], 1e-300)
        kept = (target == np.arange(len(target))) & (tracks.weights > least)
        members: dict[int, list[int]] = {}
        for row in np.flatnonzero(kept).tolist():
            members.setdefault(int(owner[row]), []).append(row)
        groups: dict[int, list[Alternative]] = {}
        logs = np.log(np.maximum(totals, 1e-300)).tolist()
        for h in np.flatnonzero(leader == np.arange(len(self))).tolist():
            groups.setdefault(int(self.group[h]), []).append((logs[h], tuple(members.get(h, ()))))
        result = []
        for alternatives in groups.values():
            alternatives.sort(key=lambda item: -item[0])
            best = alternatives[0][0]
            chosen = [item for item in alternatives[:most] if item[0] > best - margin]
            if any(rows for _, rows in chosen):
                result.append(chosen)
        return Hypotheses.of(tracks, result)


def _product(parts: list[list[Alternative]], most: int) -> list[Alternative]:
    """All combinations of independent alternatives, the likeliest `most`."""
    whole = parts[0]
    for part in parts[1:]:
        whole = [(a + b, rows + more) for a, rows in whole for b, more in part]
        whole = sorted(whole, key=lambda item: -item[0])[:most]
    return whole


def _moments(tracks: Components, weights: FloatArray, target: IntArray) -> Components:
    """Rows that take up others: total weights, means, covariances with the spread of means, and statistics."""
    if bool((target == np.arange(len(target))).all()):
        merged = tracks.select(np.arange(len(target)))
        merged.weights = weights
        return merged
    states = States(tracks.means, tracks.covariances, tracks.counts, tracks.spread, tracks.freedom)
    totals, joined = moments(states, weights, target)
    return Components(
        totals,
        joined.means,
        joined.covariances,
        tracks.labels.copy(),
        joined.counts,
        joined.spread,
        joined.freedom,
    )
