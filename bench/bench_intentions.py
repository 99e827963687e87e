"""Times of motion prediction with 500 learned walks, each beside a named alternative in the same run.

`python bench/bench_intentions.py` prints the table and writes it to `bench/bench_intentions.txt`. Walks are simulated:
between seven exits of a hall, each along a bend of its own. Nothing here is a test.
"""

from __future__ import annotations

import os
import platform
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

# Before numpy starts its threads: one core is what is measured.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from scipy.sparse import csr_matrix

from evaluation.experiments.intentions import simulated_walks
from tracking.intentions import IntentionConfig, IntentionModel

LEARNED = 500


def least(function: Callable[[], object], repeats: int = 30) -> float:
    """Milliseconds of the fastest of several rounds."""
    times = []
    for _ in range(repeats):
        begin = perf_counter()
        function()
        times.append(1e3 * (perf_counter() - begin))
    return min(times)


def learning(method: str, walks: list[np.ndarray]) -> tuple[IntentionModel, list[float]]:
    """A model of 500 walks, and the milliseconds of each of the last hundred."""
    model = IntentionModel(IntentionConfig(method=method))
    times = []
    for walk in walks[:LEARNED]:
        begin = perf_counter()
        model.learn(walk)
        times.append(1e3 * (perf_counter() - begin))
    return model, times[-100:]


def plain_update(model: IntentionModel) -> tuple[float, float]:
    """One belief update (4.11) with (4.12), and the same by a sparse matrix product and numpy."""
    hmm = model.hmm
    point = np.array([8.0, 4.0])
    belief = hmm.start(point)
    count = len(hmm)
    row, column = np.nonzero(hmm.successors >= 0)
    sparse = csr_matrix(
        (hmm.transitions[row, column], (hmm.successors[row, column], row)), shape=(count, count)
    )

    def ours() -> object:
        return hmm.intentions(hmm.update(belief, point))

    def other() -> object:
        log_b = hmm.log_observations(point[None])[0][hmm.node]
        weights = (sparse @ belief) * np.exp(log_b - log_b.max())
        weights /= weights.sum()
        return hmm.intentions(weights)

    np.testing.assert_allclose(ours()[1], other()[1], atol=1e-9)  # type: ignore[index]
    return least(ours), least(other)


def main() -> None:
    """Prints and writes the table."""
    walks = simulated_walks(0, LEARNED + 40)
    partials = [walk[: len(walk) // 2] for walk in walks[LEARNED : LEARNED + 20]]
    corridor = np.column_stack((np.linspace(0, 16, 3200), np.tile([-0.5, 12.0], 1600)))
    rows = [
        f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, one core",
        f"{LEARNED} learned walks of {np.mean([len(w) for w in walks]):.0f} observations, least of 30 rounds, ms",
        "",
    ]
    for method in ("routes", "ghmm"):
        IntentionModel(IntentionConfig(method=method)).warm_up()
        model, times = learning(method, walks)
        model.predict_all(partials, 10.0, corridor)
        rows.append(f"{method}:")
        rows.append(
            f"  learn a walk                  median {np.median(times):8.3f}   p95 {np.percentile(times, 95):8.3f}"
        )
        one = least(lambda model=model: model.intentions(partials[0]))  # type: ignore[misc]
        rows.append(f"  goals of one person, anew            {one:8.3f}")
        alone = least(lambda model=model: model.predict(partials[0], 10.0))  # type: ignore[misc]
        rows.append(f"  one person over 10 s                 {alone:8.3f}")
        many = least(lambda model=model: model.predict_all(partials, 10.0))  # type: ignore[misc]
        each = least(lambda model=model: [model.predict(p, 10.0) for p in partials])  # type: ignore[misc]
        rows.append(f"  20 people over 10 s together         {many:8.3f}   each on its own {each:8.3f}")
        walls = least(lambda model=model: model.predict_all(partials, 10.0, corridor))  # type: ignore[misc]
        rows.append(f"  the same between 3200 wall points    {walls:8.3f}")
        if method == "ghmm":
            ours, other = plain_update(model)
            hmm = model.hmm
            beside = f"scipy.sparse {other:8.3f}, ratio {ours / other:.2f}"
            rows.append(f"  one belief update, {len(hmm)} states     {ours:8.3f}   {beside}")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.npz"
            save = least(lambda model=model, path=path: model.save(path), 5)  # type: ignore[misc]
            load = least(lambda path=path: IntentionModel.load(path), 5)  # type: ignore[misc]
            rows.append(f"  save, load ({path.stat().st_size / 1024:.0f} kB)       {save:8.1f} {load:8.1f}")
    text = "\n".join(rows) + "\n"
    print(text)
    Path(__file__).with_suffix(".txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
