"""What could raise the text's method across places: other readings of App. A.A, and which logs learn and judge."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from evaluation.report import Report, RunOptions, Table
from loop_closure import AdaBoost
from loop_closure.places.features import PlaceFeatures
from loop_closure.places.pairs import PairRule, compare_pairs
from loop_closure.training.place_evaluation import balanced
from loop_closure.training.place_training import Recording
from loop_closure.training.roc import roc
from whereabouts.system.progress import track

RuleOf = Callable[[Recording, float], PairRule]
Sets = Mapping[str, tuple[FloatArray, npt.NDArray[np.integer]]]
DISTANCES = (1.0, 2.0, 3.0)
RATES = (0.01, 0.001)
COLUMNS = [f"D at {100 * rate:g} % FA within {distance:g}, % ↑" for rate in RATES for distance in DISTANCES]
# Features of all points, and those of the points below r_max that they become where no-returns are no points (from 1).
WITHOUT_NO_RETURNS = {1: 2, 4: 3, 6: 5, 15: 16, 22: 21, 23: 25, 24: 26}
# Features that grow with the number of beams: counts and sums.
COUNTS = (13, 14, 15, 16, 17, 33, 34, 35)


def as_defined(place: PlaceFeatures) -> PlaceFeatures:
    """`loop_closure.places.definitions` as it is."""
    return place


def no_returns_dropped(place: PlaceFeatures) -> PlaceFeatures:
    """No-returns are neither points nor ranges: out of features of all points and out of the last bins."""
    values = place.values.copy()
    for everything, below in WITHOUT_NO_RETURNS.items():
        values[everything - 1] = values[below - 1]
    return replace(place, values=values, histograms=_without_last(place))


def no_returns_out_of_histograms(place: PlaceFeatures) -> PlaceFeatures:
    """No-returns count but in the histograms."""
    return replace(place, histograms=_without_last(place))


def shares_of_beams(place: PlaceFeatures) -> PlaceFeatures:
    """Counts and sums divided by the number of beams."""
    values = place.values.copy()
    beams = values[12] + values[13]
    values[[k - 1 for k in COUNTS]] /= beams
    return replace(place, values=values)


def area_of_all_beams(place: PlaceFeatures) -> PlaceFeatures:
    """Feature 2 is divided by the number of all beams."""
    values = place.values.copy()
    values[1] *= values[13] / (values[12] + values[13])
    return replace(place, values=values)


class UncentredPlace(PlaceFeatures):
    """A place whose histograms are compared by their cosine: no mean is taken off."""

    @property
    def profile(self) -> npt.NDArray[np.float32]:
        """Histograms of unit length in the layout of `PlaceFeatures.profile`."""
        parts = [np.append(h / max(float(np.linalg.norm(h)), 1e-12), 0.0) for h in self.histograms]
        return np.concatenate(parts).astype(np.float32)


def uncentred_correlation(place: PlaceFeatures) -> PlaceFeatures:
    """The correlation is that of the counts themselves."""
    return UncentredPlace(place.values, place.histograms, place.max_range)


def logarithms(place: PlaceFeatures) -> PlaceFeatures:
    """Differences of logarithms, which equation (4) does not say."""
    return replace(place, values=np.sign(place.values) * np.log1p(np.abs(place.values)))


READINGS: dict[str, Callable[[PlaceFeatures], PlaceFeatures]] = {
    "as defined": as_defined,
    "no-returns are no points": no_returns_dropped,
    "no-returns not in histograms": no_returns_out_of_histograms,
    "counts and sums by number of beams": shares_of_beams,
    "all three": lambda place: shares_of_beams(no_returns_dropped(place)),
    "feature 2 by all beams": area_of_all_beams,
    "correlation without taking off the mean": uncentred_correlation,
    "differences of logarithms (not equation 4)": logarithms,
}


def _without_last(place: PlaceFeatures) -> tuple[FloatArray, ...]:
    """Histograms without the ranges at the limit, which are in the last bin of each."""
    found = []
    for histogram in place.histograms:
        kept = histogram.copy()
        kept[-1] -= place.values[12]
        found.append(kept)
    return tuple(found)


def readings(
    options: RunOptions, report: Report, recordings: Mapping[str, Recording], rule_of: RuleOf
) -> None:
    """The text's method across places with each of READINGS, mean over buildings, headings within 45°."""
    scans = {name: recording for name, recording in recordings.items() if recording.dimension == 2}
    buildings = list(dict.fromkeys(recording.environment for recording in scans.values()))
    if len(buildings) < 2:
        return
    rows: list[list[Any]] = []
    for label, read in track(READINGS.items(), "readings"):
        sets = _sets(
            options, {k: replace(r, places=[read(p) for p in r.places]) for k, r in scans.items()}, rule_of
        )
        found = []
        for building in buildings:
            own = [name for name, scan in scans.items() if scan.environment == building]
            found.append(_judged(sets, [name for name in scans if name not in own], own, options.seed))
        mean = _mean(found)
        rows.append([label, *mean])
    report.tables.append(
        Table(
            "Other readings of App. A.A: the text's method, mean over buildings",
            ["reading", *COLUMNS],
            rows,
            "The columns state the distance that counts as the same place. Each building is judged by a classifier of "
            "the others.",
            "readings",
            data="tuned on",
            samples=len(buildings),
        )
    )


def chosen_logs(
    options: RunOptions, report: Report, recordings: Mapping[str, Recording], rule_of: RuleOf
) -> None:
    """The text's method trained on all but two logs and judged on those two, for every two, by two rules of pairs.

    Killian Court is left out: it is the building of infinite-corridor.
    """
    scans = {k: r for k, r in recordings.items() if r.dimension == 2 and k != "killian"}
    if len(scans) < 3:
        return

    def loose(recording: Recording, distance: float) -> PairRule:
        return replace(rule_of(recording, distance), neighbours=True, apart=10.0)

    rows: list[list[Any]] = []
    samples: dict[str, int] = {}  # pairs of all logs at all distances
    for rule, ruled in (("20 m of path apart", rule_of), ("loose", loose)):
        sets = _sets(options, scans, ruled)
        found = []
        for own in combinations(scans, 2):
            found.append(_judged(sets, [name for name in scans if name not in own], own, options.seed))
            rows.append([rule, " and ".join(own), *found[-1]])
        mean = _mean(found)
        rows.append([rule, "mean", *mean])
        samples[rule] = sum(len(y) for at in sets.values() for _, y in at.values())
    report.tables.append(
        Table(
            "Which logs learn and which judge: the text's method",
            ["pairs", "judged on, trained on the others", *COLUMNS],
            rows,
            "The columns state the distance that counts as the same place. Loose: positive pairs may be near along the "
            "path, and negative ones are at least 10 m apart.",
            "chosen",
            data="tuned on",
            samples=samples,
        )
    )


def _sets(options: RunOptions, scans: Mapping[str, Recording], rule_of: RuleOf) -> dict[float, Sets]:
    """Pair features and labels of each log at each distance."""
    positives, negatives = (300, 2000) if options.quick else (1000, 6000)
    found: dict[float, Sets] = {}
    for distance in DISTANCES:
        sets = {}
        for name, scan in scans.items():
            pairs = scan.pairs(rule_of(scan, distance), negatives, positives, options.seed)
            sets[name] = (compare_pairs(scan.places, pairs), pairs.same)
        found[distance] = sets
    return found


def _judged(sets: Mapping[float, Sets], others: Sequence[str], own: Sequence[str], seed: int) -> list[float]:
    """D in % as COLUMNS, mean over the logs `own`, by a classifier of the logs `others`."""
    found = []
    for distance in DISTANCES:
        model = AdaBoost(50).fit(*balanced([sets[distance][name] for name in others], 1000, seed))
        curves = [roc(model.score(F), y) for F, y in (sets[distance][name] for name in own)]
        found.append([100.0 * np.mean([c.detection_at(rate) for c in curves]) for rate in RATES])
    return [float(value) for value in np.array(found).T.ravel()]


def _mean(found: Sequence[Sequence[float]]) -> list[float]:
    return [float(value) for value in np.mean(found, axis=0)]
