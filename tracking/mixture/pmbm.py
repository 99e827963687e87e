"""The Poisson multi-Bernoulli mixture filter for extended targets (Granström, Fatemi, Svensson 2020), as ours is built.

Targets nobody has seen yet are a Poisson intensity as in a PHD filter. Each seen one is a track with a probability of
existence, and several hypotheses say which tracks there are. In place of partitions, each hypothesis searches for
the structures (who gave returns, who is new, who split off) its group of returns supports
(`tracking.mixture.association_kernels`). Unlike the intensity of a PHD filter, a hypothesis counts a detected
target once however improbable the detection was: the number of targets neither falls with a miss nor jumps at low p_D.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from estimation.checks import FloatArray
from tracking.mixture import association_kernels as kernels
from tracking.mixture.birth_seeds import Predicted, ReturnLooks, Seeds, narrow_places, seeds_among
from tracking.mixture.components import Components, IntArray, shift_components
from tracking.mixture.correction_kernels import Exactness, States, correct
from tracking.mixture.global_hypotheses import Alternative, Hypotheses
from tracking.mixture.hypothesis_kernels import connected, squares
from tracking.mixture.phd_config import PhdConfig
from tracking.mixture.phd_models import ConstantVelocityMotion, Detection, Labels, Sight, detect
from tracking.mixture.reduction import Reducer, sound
from tracking.mixture.target import HypothesisExtractor, Target

# Sweeps of the association; they settle in three or four.
SWEEPS = 8
# Structures of one hypothesis that are varied further.
EXPANSIONS = 4
# Returns times sources times structures searched per group and scan at most, about 50 ms; never near it in ordinary
# scans. Beyond it fewer variations and fewer hypotheses are searched.
MOST_WORK = 3_000_000
# Undiscovered targets: weights below this are forgotten, more components than this are merged.
LEAST_UNSEEN = 1e-4
MOST_UNSEEN = 50

State = tuple[Hypotheses, Components, int, dict[int, float]]


class Updates:
    """Collects the tracks of the hypotheses that follow from one scan."""

    def __init__(self) -> None:
        self.source: list[IntArray] = []
        self.label: list[IntArray] = []
        self.seen: list[npt.NDArray[np.bool_]] = []
        self.cells: list[FloatArray] = []
        self.groups: list[list[Alternative]] = []
        self.count = 0

    def add(
        self, sources: IntArray, labels: IntArray, seen: npt.NDArray[np.bool_], cells: FloatArray
    ) -> tuple[int, ...]:
        """Tracks from sources (n,), and the cells (m, 9) of the m that were seen; their rows."""
        self.source.append(sources)
        self.label.append(labels)
        self.seen.append(seen)
        self.cells.append(cells)
        self.count += len(sources)
        return tuple(range(self.count - len(sources), self.count))


class PmbmRecursion:
    """Prediction, grouping, association, correction, reduction and extraction of a Poisson multi-Bernoulli mixture."""

    def __init__(self, config: PhdConfig, detection: Detection) -> None:
        self.config = config
        self.motion = ConstantVelocityMotion(config)
        self.detection = detection
        self.labels = Labels()
        self.reducer = Reducer(config, self.labels)
        self.extractor = HypothesisExtractor(config)
        self.hypotheses = Hypotheses.empty()
        self.unseen = Components.empty()
        self.log_clutter = float(np.log(config.clutter_rate / config.area))
        self.correlation = 0.0
        self.gate = float(chdtri(2, 1.0 - config.gate_probability))
        self.link = config.measurement_noise * float(
            np.sqrt(chdtri(2, 1.0 - config.distance_probabilities[1]))
        )
        # Probability that a target is of the first class, by label.
        self.classes: dict[int, float] = {}
        self.model = kernels.CellModel(self.gate, config.rate_spread == 0.0, SWEEPS)
        self.repaired = 0
        self.thinned = 0

    @property
    def expected_count(self) -> float:
        """Expected number of targets, undiscovered ones included."""
        return float(self.hypotheses.track_weights.sum() + self.unseen.weights.sum())

    def reset(self) -> None:
        """Forgets all targets; labels go on counting."""
        self.hypotheses, self.unseen = Hypotheses.empty(), Components.empty()

    def state(self) -> State:
        """What `restore` takes; valid as long as nobody changes the arrays."""
        return self.hypotheses, self.unseen, self.labels.next, dict(self.classes)

    def restore(self, state: State) -> None:
        """Back to an earlier state."""
        self.hypotheses, self.unseen, self.labels.next, classes = state
        self.classes = dict(classes)

    def targets(self) -> list[Target]:
        """The targets of the likeliest hypotheses."""
        return self.extractor.extract(self.hypotheses)

    def shift(self, motion: FloatArray) -> None:
        """Takes everything along with its frame, which moved by (3,) x, y, yaw."""
        for components in (self.hypotheses.tracks, self.unseen):
            shift_components(components, motion)

    def forget(self, gone: set[int], moved: dict[int, FloatArray]) -> None:
        """Drops targets by the labels they are reported by, and moves the states of others by (4,)."""
        inner = {name: label for label, name in self.extractor.labels.public.items()}
        tracks = self.hypotheses.tracks
        tracks.weights = np.where(np.isin(tracks.labels, [inner[name] for name in gone]), 0.0, tracks.weights)
        for name, way in moved.items():
            tracks.means[tracks.labels == inner[name]] += way

    def classify(self, known: dict[int, float]) -> None:
        """Probabilities of the first class by the labels that targets are reported by; others keep theirs."""
        public = self.extractor.labels.public
        self.classes = {label: known.get(public.get(label, -1), p) for label, p in self.classes.items()}

    def update(
        self, points: FloatArray, dt: float, pose: FloatArray | None, looks: ReturnLooks | None = None
    ) -> None:
        """One scan (N, 2), dt seconds after the last; looks where clutter and births are not those of the settings."""
        predicted = self._predict(points, dt, pose)
        clutter = np.full(len(points), self.log_clutter) if looks is None else looks.log_clutter
        look = np.zeros(len(points)) if looks is None else looks.look
        updates = self._associate(predicted, np.column_stack((points, clutter, look)), looks)
        tracks = self._corrected(predicted, updates, points, None if looks is None else looks.exactness)
        hypotheses = Hypotheses.of(tracks, updates.groups)
        hypotheses.tracks.covariances, repaired = sound(hypotheses.tracks.covariances)
        self.repaired += repaired
        config = self.config
        self.hypotheses = hypotheses.reduced(
            config.hypothesis_distance, config.hypothesis_margin, config.max_hypotheses, config.prune_weight
        )
        there = set(self.hypotheses.tracks.labels.tolist())
        self.classes = {label: p for label, p in self.classes.items() if label in there}
        if looks is not None:
            # The scan itself says where targets may be that nobody has seen.
            self.unseen = Components.empty()
            return
        births = slice(predicted.tracks, predicted.tracks + predicted.births)
        self.unseen = predicted.sources.select(np.arange(births.start, births.stop))
        self.unseen.weights = self.unseen.weights * (1.0 - predicted.seen[births])
        self.unseen.means = predicted.sight.means[births]
        self.unseen.covariances = predicted.sight.covariances[births]
        self.unseen = self.unseen.select(self.unseen.weights > LEAST_UNSEEN)
        if len(self.unseen) > MOST_UNSEEN:
            self.unseen = self.reducer.reduce(self.unseen)

    def _predict(self, points: FloatArray, dt: float, pose: FloatArray | None) -> Predicted:
        """Everything that may have caused returns, as a table for the association."""
        tracks, unseen, spawned = self.hypotheses.tracks, self.unseen, Components.empty()
        scans = dt / self.config.scan_period
        if dt > 0.0:
            tracks, moved = self.motion.survivors(tracks, dt)
            born = self.motion.births(scans, Labels())
            unseen = Components.join([self.motion.survivors(unseen, dt)[0], born]) if len(unseen) else born
            if self.config.spawn is not None and self.config.spawn[0] > 0:
                weight, covariance = self.config.spawn
                spawned = self.motion.fresh(
                    weight * scans * tracks.weights, tracks.means, moved + covariance, Labels()
                )
        sources = Components.join([tracks, unseen, spawned])
        weights = self.hypotheses.track_weights
        sight = detect(self.detection, sources, weights, len(tracks), pose)
        table, seen = self._table(sources, sight, len(tracks))
        spread = table[:, [kernels.XXX, kernels.XXY, kernels.XYY]]
        if len(spawned):
            # A track gates what it or a part of it may have caused.
            extra = (spawned.covariances - tracks.covariances)[:, :2, :2]
            spread[: len(tracks)] += np.maximum(extra.reshape(-1, 4)[:, [0, 1, 3]], 0.0)
        P = sources.covariances
        both = len(tracks) + len(unseen)
        distances = squares(
            points,
            sources.means[:both, :2],
            P[:both, 0, 0] + spread[:both, 0],
            P[:both, 0, 1] + spread[:both, 1],
            P[:both, 1, 1] + spread[:both, 2],
        )
        return Predicted(sources, len(tracks), len(unseen), table, seen, sight, distances < self.gate)

    def _table(self, sources: Components, sight: Sight, tracks: int) -> tuple[FloatArray, FloatArray]:
        """Rows (S, 13) of `tracking.mixture.association_kernels`, and the probability (S,) of giving any return."""
        config, count, share = self.config, len(sources), sight.share
        table = np.empty((count, kernels.COLUMNS))
        P = sources.covariances
        table[:, [kernels.MX, kernels.MY]] = sources.means[:, :2]
        table[:, [kernels.PXX, kernels.PXY, kernels.PYY]] = P.reshape(-1, 16)[:, [0, 1, 5]]
        noise = config.measurement_noise**2
        spread = np.array([noise, 0.0, noise])
        table[:, [kernels.XXX, kernels.XXY, kernels.XYY]] = spread
        # The returns of a half-hidden target are not about its middle.
        table[:, [kernels.PXX, kernels.PXY, kernels.PYY]] += (1.0 - share)[:, None] * spread
        shape, rate = sources.counts.T
        # A gamma density scales by its rate parameter: what is hidden of a target gives no returns.
        rate = np.maximum(rate, 1e-9) / share
        if config.rate_spread == 0.0:
            shape, rate = config.measurement_rate * share, np.ones(count)
            some = -np.expm1(-shape)
        else:
            some = 1.0 - (rate / (rate + 1.0)) ** shape
        table[:, kernels.ALPHA], table[:, kernels.BETA] = shape, rate
        detection = np.clip(sight.probability, 1e-9, 1.0)
        seen = detection * some
        table[:, kernels.ON] = np.log(np.maximum(sources.weights * sight.at_return, 1e-300))
        table[:, kernels.CLASS] = [self.classes.get(label, 0.0) for label in sources.labels.tolist()]
        table[:, kernels.OFF] = 0.0
        table[:tracks, kernels.OFF] = np.log1p(-np.minimum(sources.weights * seen, 1.0 - 1e-12)[:tracks])
        return table, seen

    def _associate(self, predicted: Predicted, returns: FloatArray, looks: ReturnLooks | None) -> Updates:
        """The hypotheses that follow from every group's hypotheses and returns (N, 4)."""
        points = np.ascontiguousarray(returns[:, :2])
        tracks, births = predicted.tracks, predicted.births
        names, label = np.unique(predicted.sources.labels[:tracks], return_inverse=True)
        narrow = narrow_places(predicted, self.config.measurement_noise)
        gated = predicted.gated
        parent = connected(
            gated[:tracks], label, len(names), gated[tracks : tracks + births], narrow, points, self.link
        )
        place = parent[label].tolist()
        old = Hypotheses(
            predicted.sources.select(np.arange(tracks)),
            self.hypotheses.starts,
            self.hypotheses.log_weights,
            self.hypotheses.group,
        )
        groups = old.arranged(place, self.config.max_hypotheses)
        of_return = parent[len(names) :]
        order = np.argsort(of_return, kind="stable")
        bounds = np.flatnonzero(np.diff(of_return[order])) + 1
        inside = {int(of_return[part[0]]): part for part in np.split(order, bounds) if len(part)}
        updates = Updates()
        nothing = np.zeros(0, dtype=np.int64)
        for where in [*groups, *(where for where in inside if where not in groups)]:
            alternatives = groups.get(where, [(0.0, ())])
            members = inside.get(where, nothing)
            seeds = seeds_among(predicted, points, members, narrow, self.link, looks)
            if where in groups or seeds.rows:
                self._group(predicted, returns[members], alternatives, seeds, updates)
        return updates

    def _group(
        self,
        predicted: Predicted,
        returns: FloatArray,
        alternatives: list[Alternative],
        seeds: Seeds,
        updates: Updates,
    ) -> None:
        """Structures of one group of returns (n, 4) under each of its hypotheses."""
        config, sources, places = self.config, predicted.sources, seeds.rows
        fresh: dict[int, int] = {}
        results: list[Alternative] = []
        top = max(value for value, _ in alternatives)
        alternatives, expansions, spawning = self._affordable(alternatives, len(returns), len(places))
        for value, rows in alternatives:
            if len(returns) == 0:
                log_weight = float(predicted.table[list(rows), kernels.OFF].sum())
                index = np.array(rows, dtype=np.int64)
                nothing = np.zeros(len(rows), dtype=bool), np.zeros((0, kernels.CELL))
                results.append((value + log_weight, updates.add(index, sources.labels[index], *nothing)))
                continue
            spawns = predicted.spawn_rows(rows) if spawning else []
            index = np.array([*rows, *places, *spawns], dtype=np.int64)
            known, grown = len(rows), len(rows) + len(places)
            table = predicted.table[index]
            table[known:grown] = seeds.table
            margin = config.hypothesis_margin + min(0.0, value - top)
            budget = kernels.SearchBudget(margin, config.max_hypotheses, expansions)
            weights, on, cells = kernels.search(returns, table, known, seeds.places, self.model, budget)
            labels = sources.labels[index]
            for k in (known + np.flatnonzero(on[:, known:].any(0))).tolist():
                # One number for what is new at one seed, or off one target, whichever the hypothesis.
                key = int(labels[(k - grown) // 2]) if k >= grown else known - k - 1
                if key not in fresh:
                    fresh[key] = int(self.labels.take(1)[0])
                    self.classes[fresh[key]] = float(table[k, kernels.CLASS])
                labels[k] = fresh[key]
            shown = on.copy()
            shown[:, :known] = True
            for structure, seen, there, cell in zip(weights.tolist(), on, shown, cells, strict=True):
                members = updates.add(index[there], labels[there], seen[there], cell[seen])
                results.append((value + structure, members))
        updates.groups.append(results)

    def _affordable(
        self, alternatives: list[Alternative], returns: int, places: int
    ) -> tuple[list[Alternative], int, bool]:
        """Hypotheses to search, how many of their structures to vary, and whether targets may split."""
        largest = max(len(rows) for _, rows in alternatives)
        for expansions, spawning in ((EXPANSIONS, True), (1, True), (1, False), (0, False)):
            sources = largest * (3 if spawning else 1) + places
            work = returns * (largest + 1) * (1 + expansions * sources)
            if work <= MOST_WORK:
                break
        count = max(MOST_WORK // max(work, 1), 1)
        if count < len(alternatives) or expansions < EXPANSIONS:
            self.thinned += 1
        return sorted(alternatives, key=lambda item: -item[0])[:count], expansions, spawning

    def _corrected(
        self, predicted: Predicted, updates: Updates, points: FloatArray, exactness: FloatArray | None
    ) -> Components:
        """The tracks after the scan: missed ones less probable, detected ones updated by (10)."""
        if not updates.count:
            return Components.empty()
        index, seen = np.concatenate(updates.source), np.concatenate(updates.seen)
        tracks = predicted.sources.select(index)
        tracks.labels = np.concatenate(updates.label)
        p = predicted.seen[index]
        # 1 - r p as in the association, so that a certain target is never divided by 0.
        missed = tracks.weights * (1.0 - p) / np.maximum(1.0 - tracks.weights * p, 1e-12)
        tracks.weights = np.where(seen, 1.0, np.minimum(missed, 1.0))
        # Where a target is not seen, it rather is where it is hidden.
        tracks.means[~seen] = predicted.sight.means[index[~seen]]
        tracks.covariances[~seen] = predicted.sight.covariances[index[~seen]]
        if not seen.any():
            return tracks
        cells = np.concatenate(updates.cells)
        rows = np.flatnonzero(seen)
        exact = np.ones(len(points)) if exactness is None else exactness
        states = States(tracks.means, tracks.covariances, tracks.counts, tracks.spread, tracks.freedom)
        sources = index[seen]
        shares = predicted.sight.share[sources]
        correct(
            states, rows, cells, predicted.table[sources], shares, Exactness(points, exact), self.correlation
        )
        return tracks
