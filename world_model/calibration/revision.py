"""All that a moving sensor said about resting objects, explained at once: later evidence corrects earlier conclusions.

Places of objects, the constant errors of the sensor (`sensor_bias`) and errors that all detections of a look share and
that change slowly (of the robot's pose, of the sensor's mounting) are estimated together by least squares, and every
detection is given anew to the object that explains it best, each object explaining one detection of a look at most.
In polar coordinates about the sensor, where its errors are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from estimation.checks import FloatArray
from estimation.filters.assignment import cheapest
from estimation.geometry.rotations import wrap_angle
from world_model.anchoring.loops.leaves import IntArray, Leaves
from world_model.calibration.sensor_bias import (
    CONSTANT,
    JITTER,
    PRIOR,
    QUICK,
    SECONDS,
    SLOW,
    STEPS,
    constants,
    lines_of_sight,
)
from world_model.evidence import Measurements

ROUNDS = 12
UNKNOWN = 25.0  # Squared Mahalanobis distance from which a detection is of nothing that is known


@dataclass(frozen=True)
class Sightings:
    """N detections in F looks, in the order of time.

    stamps (F,) s; poses (F, 4) x, y, z, yaw; look (N,) : index of each detection's look. seen (N, 2) : range, m, and
    bearing off the sensor's axis, rad; sigma (N, 2) : standard deviations. unlike (N, K) : -2 log of how well
    the attributes of each object explain those of a detection. rates (F, 3) : of the sensor, m/s and rad/s.
    """

    stamps: FloatArray
    poses: FloatArray
    look: IntArray
    seen: FloatArray
    sigma: FloatArray
    unlike: FloatArray
    rates: FloatArray

    @property
    def quick(self) -> FloatArray:
        """Standard deviations (F, 2) of errors of range and bearing that a look has for itself."""
        turn = np.hypot(QUICK[1], JITTER * self.rates[:, 2])
        return np.stack([np.full(len(turn), QUICK[0]), turn], -1)


@dataclass(frozen=True)
class Explanation:
    """places (K, 2), m; constant (8,), shared (F, 2) : errors of range and bearing; owner (N,) : object, -1: none."""

    places: FloatArray
    constant: FloatArray
    shared: FloatArray
    owner: IntArray


def residuals(data: Sightings, found: Explanation) -> FloatArray:
    """(N, K, 2) : what is left of range and bearing if a detection is of an object, without shared errors."""
    distance, bearing, sight = lines_of_sight(found.places[None], data.poses[data.look][:, None])
    off = constants(distance, bearing, sight, data.rates[data.look][:, None]) @ found.constant
    return np.stack(
        [data.seen[:, :1] - distance - off[..., 0], wrap_angle(data.seen[:, 1:] - bearing - off[..., 1])], -1
    )


def assign(data: Sightings, found: Explanation) -> IntArray:
    """The object (N,) that explains each detection best, given all others of its look; -1 for none."""
    spread = data.quick[data.look, 1]
    N, F, K = len(data.look), len(data.stamps), len(found.places)
    left = residuals(data, found) - found.shared[data.look][:, None]
    costs = np.empty((len(STEPS), N, K))
    for index, step in enumerate(STEPS):
        off = left.copy()
        off[..., 1] -= step * spread[:, None]
        cost = ((off / data.sigma[:, None]) ** 2).sum(2) + data.unlike
        costs[index] = np.minimum(cost, UNKNOWN)
    # If the best of each is nobody else's, it is the best of all.
    nearest = costs.argmin(2)
    alone = np.take_along_axis(costs, nearest[..., None], 2)[..., 0]
    sums = np.tile(STEPS[:, None] ** 2, (1, F))
    for index in range(len(STEPS)):
        sums[index] += np.bincount(data.look, alone[index], F)
    chosen = sums.argmin(0)[data.look]
    at = np.arange(N)
    owner = np.where(alone[chosen, at] < UNKNOWN, nearest[chosen, at], -1)
    pairs, counts = np.unique(data.look[owner >= 0] * K + owner[owner >= 0], return_counts=True)
    bounds = np.searchsorted(data.look, np.arange(F + 1))
    for f in np.unique(pairs[counts > 1] // K).tolist():
        owner[bounds[f] : bounds[f + 1]] = _joint(costs[:, bounds[f] : bounds[f + 1]])
    return owner


def _joint(costs: FloatArray) -> IntArray:
    """Owners (M,) of a look's detections for costs (S, M, K) by shared error, each object at most once."""
    best, owner = np.inf, np.full(costs.shape[1], -1)
    for cost, step in zip(costs, STEPS, strict=True):
        rows, columns = cheapest(cost)
        value = float(cost[rows, columns].sum() + step**2)
        if value < best:
            best = value
            owner = np.full(costs.shape[1], -1)
            good = cost[rows, columns] < UNKNOWN
            owner[rows[good]] = columns[good]
    return owner


def _shared_prior(
    stamps: FloatArray, quick_sigma: FloatArray
) -> list[tuple[sparse.csr_matrix, sparse.csr_matrix]]:
    """Per kind of error: rows that say how the slow part goes on, over (slow, quick) of all looks."""
    fade = np.exp(-np.diff(stamps) / SECONDS)
    out = []
    for slow, quick in zip(SLOW, quick_sigma.T, strict=True):
        weight = np.concatenate([[1.0 / slow], 1.0 / (slow * np.sqrt(np.maximum(1.0 - fade**2, 1e-8)))])
        chain = sparse.diags(weight) - sparse.diags(fade * weight[1:], -1)
        out.append((chain.tocsr(), sparse.diags(1.0 / quick).tocsr()))
    return out


def solve(data: Sightings, found: Explanation, known: FloatArray) -> Explanation:
    """One Gauss-Newton step for everything but the owners; known (8,) : a calibration."""
    F, K = len(data.stamps), len(found.places)
    used = np.flatnonzero(found.owner >= 0)
    owner, look = found.owner[used], data.look[used]
    poses, n = data.poses[look], np.arange(len(used))
    distance, bearing, sight = lines_of_sight(found.places[owner], poses)
    errors = constants(distance, bearing, sight, data.rates[look])
    across = np.stack([-sight[:, 1], sight[:, 0]], -1) / distance[:, None]

    def over(values: FloatArray, columns: IntArray, size: int) -> sparse.csr_matrix:
        """A row per detection with values (n, c) in columns (n, c) of `size`."""
        place = np.repeat(n, columns.shape[1]), columns.ravel()
        return sparse.csr_matrix((values.ravel(), place), shape=(len(n), size))

    # Unknowns: places, constants, and per kind the slow and the quick part of every look.
    rows: list[list[sparse.csr_matrix | None]] = []
    rights = []
    for kind in range(2):
        weight = 1.0 / data.sigma[used, kind][:, None]
        change = sight * (1.0 + found.constant[1]) if kind == 0 else across
        to_look = over(weight, look[:, None], F)
        places = over(change * weight, 2 * owner[:, None] + np.arange(2), 2 * K)
        constant = over(errors[:, kind] * weight, np.tile(np.arange(CONSTANT), (len(n), 1)), CONSTANT)
        own, other = [to_look, to_look], [None, None]
        rows.append([places, constant, *(own + other if kind == 0 else other + own)])
        # Linear in everything but the places: what is left with constants and shared errors of zero.
        left = data.seen[used, kind] - (distance if kind == 0 else bearing)
        left = wrap_angle(left) if kind else left
        rights.append((left + (change * found.places[owner]).sum(1)) * weight[:, 0])
    shared = [block for pair in _shared_prior(data.stamps, data.quick) for block in pair]
    for at, block in enumerate([sparse.eye(2 * K), sparse.diags(1.0 / PRIOR), *shared]):
        rows.append([block if k == at else None for k in range(6)])
    rights += [found.places.ravel(), known / PRIOR, np.zeros(4 * F)]
    A, b = sparse.bmat(rows, format="csr"), np.concatenate(rights)
    solved = np.asarray(spsolve((A.T @ A).tocsc(), A.T @ b, permc_spec="MMD_AT_PLUS_A"), dtype=np.float64)
    place, constant, parts = np.split(solved, [2 * K, 2 * K + CONSTANT])
    return Explanation(place.reshape(K, 2), constant, parts.reshape(2, 2, F).sum(1).T, found.owner)


def misfit(data: Sightings, found: Explanation) -> float:
    """How badly everything is explained: squared residuals, and `UNKNOWN` for what is not."""
    left = residuals(data, found) - found.shared[data.look][:, None]
    cost = ((left / data.sigma[:, None]) ** 2).sum(2) + data.unlike
    own = np.where(found.owner >= 0, cost[np.arange(len(cost)), found.owner], UNKNOWN)
    fade = np.exp(-np.diff(data.stamps) / SECONDS)[:, None]
    grown = SLOW**2 * (1.0 - fade**2) + data.quick[1:] ** 2
    steps = np.diff(found.shared, axis=0) + (1.0 - fade) * found.shared[:-1]
    return float(np.minimum(own, UNKNOWN).sum() + (steps**2 / grown).sum())


def _settled(data: Sightings, found: Explanation, known: FloatArray) -> Explanation:
    """Owners and everything else in turn, until nothing changes any more."""
    for _ in range(ROUNDS):
        found = solve(data, found, known)
        owner = assign(data, found)
        same = bool((owner == found.owner).all())
        found = replace(found, owner=owner)
        if same:
            break
    return found


def explain(data: Sightings, found: Explanation, known: FloatArray) -> Explanation:
    """The better of what is found from what is believed, `found`, and from what that is with blurred detections."""
    blurred = _settled(replace(data, sigma=2.0 * data.sigma), found, known)
    tried = [_settled(data, start, known) for start in (found, blurred)]
    return min(tried, key=lambda result: misfit(data, result))


@dataclass
class KeptLook:
    """stamp, s; measured : M detections as they came, without their words; likelihood (M, A); owners (M,) : numbers of
    tracks; symbols (M,) : what was said of each detection then; rate (3,) : speed of the sensor, m/s and rad/s."""

    stamp: float
    measured: Measurements
    likelihood: FloatArray
    owners: list[int]
    symbols: tuple[str | None, ...]
    rate: FloatArray


def polar(measured: Measurements) -> tuple[FloatArray, FloatArray]:
    """Range and bearing of detections (M, 2) and their standard deviations."""
    assert measured.sensor is not None
    distance, bearing, along = lines_of_sight(measured.positions[:, :2], measured.sensor.pose)
    across = np.stack([-along[:, 1], along[:, 0]], -1)
    spread = measured.covariances[:, :2, :2]
    sigma = [np.sqrt(np.einsum("ni,nij,nj->n", line, spread, line)) for line in (along, across)]
    return np.stack([distance, bearing], -1), np.stack([sigma[0], sigma[1] / distance], -1)


def explained(
    looks: Sequence[KeptLook],
    numbers: list[int],
    slots: IntArray,
    movers: set[int],
    leaves: Leaves,
    blocks: IntArray,
    known: FloatArray,
) -> tuple[Explanation, list[list[int]]]:
    """Explain looks by the resting objects `numbers` (K,), leaves `slots`; returns it, and tracks by look.

    Detections of `movers` stay theirs. known (8,) : calibration.
    """
    counts = [len(look.owners) for look in looks]
    whose = np.concatenate([look.owners for look in looks])
    mine = ~np.isin(whose, np.array(sorted(movers), np.int64))
    index = np.repeat(np.arange(len(counts)), counts)[mine]
    # Of a look from before a word was known, words say nothing.
    likelihood = np.ones((len(whose), leaves.attributes.shape[1]))
    for look, end in zip(looks, np.cumsum(counts).tolist(), strict=True):
        if look.likelihood.shape[1] == likelihood.shape[1]:
            likelihood[end - len(look.owners) : end] = look.likelihood
    likelihood = likelihood[mine]
    unlike = np.zeros((len(index), len(numbers)))
    for begin, end in blocks.tolist():
        if end > begin:
            factor = likelihood[:, begin:end] @ leaves.attributes[slots, begin:end].T
            unlike -= 2.0 * np.log(factor + 1e-9)
    stamps = np.array([look.stamp for look in looks])
    rates = np.array([look.rate for look in looks])
    poses = np.array([sensor.pose for look in looks if (sensor := look.measured.sensor) is not None])
    views = zip(*(polar(look.measured) for look in looks), strict=True)
    seen, sigma = (np.concatenate(each)[mine] for each in views)
    data = Sightings(stamps, poses, index, seen, sigma, np.maximum(unlike, 0.0), rates)
    column = {number: k for k, number in enumerate(numbers)}
    owner = np.array([column.get(number, -1) for number in whose[mine].tolist()])
    begun = Explanation(leaves.rest[slots, :2].copy(), known.copy(), np.zeros((len(counts), 2)), owner)
    found = explain(data, begun, known)
    whose[mine] = np.append(numbers, -1)[found.owner]
    return found, [part.tolist() for part in np.split(whose, np.cumsum(counts)[:-1])]
