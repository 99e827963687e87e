"""Times of place features and their comparison, with scikit-learn's classifier on the same pairs beside them.

`python bench/bench_loop_closure.py` prints the table and writes it to `bench/bench_loop_closure.txt`. Views are made
here: rooms of random outline for scans, ground and walls in 64 rings for clouds. Times are processor time, the least
of several rounds: the machine may be shared. Nothing here is a test.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from timeit import Timer

# Before numpy starts its threads: one core is what is measured.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from sklearn.ensemble import AdaBoostClassifier
from sklearn.tree import DecisionTreeClassifier

from loop_closure import (
    AdaBoost,
    PlaceDatabase,
    PlaceFeatures,
    PlaceRecognizer,
    features_2d,
    features_3d,
    pair_features,
    pair_features_many,
    shipped_model,
)
from loop_closure.places.matching import match_features
from loop_closure.places.outlines import outline_of_scan
from registration import Scan

MAX_RANGE = 50.0
HISTORY = 20_000
LONG_HISTORY = 100_000


def least(function: Callable[[], object], rounds: int = 7, budget: float = 0.15) -> float:
    """Seconds per call: the least mean over several rounds, each about `budget` seconds long."""
    function()
    timer = Timer(function, timer=time.process_time)
    number = max(1, int(budget / max(timer.timeit(1), 1e-7)))
    return min(timer.repeat(rounds, number)) / number


def room(seed: int, visit: int = 0) -> Scan:
    """A 361-beam scan of the room of this seed, with noise of its own and a few no-returns per visit."""
    shape, noise = np.random.default_rng(seed), np.random.default_rng((seed, visit))
    angle = np.linspace(-np.pi / 2, np.pi / 2, 361)
    waves = [shape.uniform(-2, 2) * np.sin(k * angle + shape.uniform(0, 6)) for k in range(1, 9)]
    ranges = np.maximum(shape.uniform(5, 15) + np.sum(waves, axis=0), 0.5) + noise.normal(0, 0.05, 361)
    ranges[noise.random(361) < 0.03] = np.inf
    return Scan(ranges, -np.pi / 2, np.pi / 360, 0.1, 80.0)


def cloud() -> np.ndarray:
    """112,000 points in 64 rings: ground 1.7 m below the sensor and a wavy wall around, (112000, 3)."""
    rng = np.random.default_rng(0)
    azimuth = np.linspace(0, 2 * np.pi, 1750, endpoint=False)[None, :]
    elevation = np.radians(np.linspace(-24, 2, 64))[:, None]
    wall = 15 + 10 * np.sin(3 * azimuth)
    r = np.minimum(1.7 / np.maximum(-np.sin(elevation), 1e-3), wall) * rng.uniform(0.99, 1.01, (64, 1750))
    flat = r * np.cos(elevation)
    return np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), r * np.sin(elevation)), -1).reshape(
        -1, 3
    )


def training_pairs(count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Pair features (2 count, 44) of rooms seen twice and of two rooms, and their labels."""
    first = [features_2d(room(i), MAX_RANGE) for i in range(count)]
    second = [features_2d(room(i, 1), MAX_RANGE) for i in range(count)]
    same = [pair_features(a, b) for a, b in zip(first, second, strict=True)]
    other = [pair_features(a, b) for a, b in zip(first, second[1:] + second[:1], strict=True)]
    return np.array(same + other), np.repeat([1, 0], count)


def history(places: list[PlaceFeatures]) -> PlaceDatabase:
    return PlaceDatabase(places[i % len(places)] for i in range(HISTORY))


def varied(places: list[PlaceFeatures], count: int) -> list[PlaceFeatures]:
    """As many places as wanted: those given with a few percent of noise on what the index sees."""
    rng = np.random.default_rng(0)
    found = []
    for i in range(count):
        place = places[i % len(places)]
        again = PlaceFeatures(place.values, place.histograms, place.max_range, place.outline)
        again.__dict__["profile"] = place.profile
        noise = 1.0 + 0.03 * rng.standard_normal(len(place.signature))
        again.__dict__["signature"] = (place.signature * noise).astype(np.float32)
        found.append(again)
    return found


def long_history(places: list[PlaceFeatures]) -> list[str]:
    """Times of the shipped model with the index of a long history."""
    model = shipped_model("best_2d")
    many = varied(places, LONG_HISTORY)
    recognizer = PlaceRecognizer(model)
    for stamp, place in enumerate(many):
        recognizer.add(place, float(stamp))
    queries = varied(places, 20)
    query = least(lambda: recognizer.query(queries[3], 10), 5, 0.05)
    database = model.database(many[:HISTORY])
    first = least(lambda: model.first.score(model.first_features(queries[3], database)), 3)
    looks = [place.outline for place in places[:100]]
    match = least(lambda: match_features(queries[3].outline, looks), 3) / len(looks)
    return [
        f"first stage of best_2d                 {HISTORY / 1e6 / first:9.3f} million pairs/s",
        f"lay one outline on another             {1e6 * match:9.1f} us",
        f"query best_2d, {LONG_HISTORY:,} places          {1e3 * query:9.3f} ms     asked: 50 ms",
        f"memory per place of best_2d            {recognizer.nbytes / LONG_HISTORY / 1e3:9.3f} kB",
    ]


def main() -> None:
    scan, points = room(0), cloud()
    places = [features_2d(room(i), MAX_RANGE) for i in range(500)]
    database, query = history(places), places[3]
    F, y = training_pairs()
    # Noise keeps the classes from being separable, which one stump would end.
    y = np.where(np.random.default_rng(1).random(len(y)) < 0.05, 1 - y, y)
    model = AdaBoost(50).fit(F, y)
    other = AdaBoostClassifier(DecisionTreeClassifier(max_depth=1), n_estimators=50, random_state=0).fit(F, y)
    recognizer = PlaceRecognizer(model)
    for i in range(HISTORY):
        recognizer.add(places[i % len(places)], float(i))
    pairs = pair_features_many(query, database)

    compare = least(lambda: pair_features_many(query, database))
    score, score_other = least(lambda: model.score(pairs)), least(lambda: other.predict_proba(pairs), 3)
    both = least(lambda: model.score(pair_features_many(query, database)))
    both_other = least(lambda: other.predict_proba(pair_features_many(query, database)), 3)
    fit, fit_other = least(lambda: AdaBoost(50).fit(F, y), 3), least(lambda: other.fit(F, y), 3)
    rate = HISTORY / 1e6
    lines = [
        f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}; one core; "
        f"history of {HISTORY:,} places, r_max {MAX_RANGE:g} m, {len(model.stumps)} stumps",
        f"features of a scan of 361 beams        {1e3 * least(lambda: features_2d(scan, MAX_RANGE)):9.3f} ms"
        "     asked: 0.3 ms; the text: 14.6 ms",
        f"features of a cloud of {len(points):,} points {1e3 * least(lambda: features_3d(points, 30.0)):9.3f} ms"
        "     asked: 10 ms; the text: 225 ms",
        f"compare                                {rate / compare:9.3f} million pairs/s",
        f"classify                               {rate / score:9.3f} million pairs/s,"
        f" {score_other / score:6.1f} x scikit-learn's AdaBoost on the same pairs",
        f"compare and classify                   {rate / both:9.3f} million pairs/s,"
        f" {both_other / both:6.1f} x with scikit-learn's;  asked: 0.5; the text: 0.000625",
        f"query for the 10 best                  {1e3 * least(lambda: recognizer.query(query, 10)):9.3f} ms",
        f"train on {len(y)} pairs, 50 rounds          {1e3 * fit:9.3f} ms,"
        f"               {fit_other / fit:6.1f} x scikit-learn's",
        f"memory per place                       {database.nbytes / HISTORY / 1e3:9.3f} kB",
        f"of the features of a scan, its outline {1e3 * least(lambda: outline_of_scan(scan)):9.3f} ms",
        *long_history(places),
    ]
    text = "\n".join(lines) + "\n"
    print(text, end="")
    Path(__file__).with_suffix(".txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
