"""What objects are like: named values as columns of a leaf, Gaussians over measured quantities (section 2.4.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.errors import InputError
from world_model.anchoring.loops.kernels import MEMORY
from world_model.anchoring.loops.leaves import IntArray, Leaves
from world_model.evidence import Distribution

CLASS = "class"
OTHER = ""  # Stands for all values that nobody has named yet
MORE = 1.0 + 1e-9  # Times as likely: rounding is no knowledge
LOWEST = 1e-4  # of all values together
LEAST = 0.01  # of a detector's probability goes to values it does not name or excludes


class Vocabulary:
    """Values of each attribute, side by side in columns; closed lists refuse other values, open ones grow.

    The first value of an open list is `OTHER`: what was never measured need not be as what was; but for classes, as
    every detection is of one. blocks (K, 2) : first column and column after the last of each attribute, classes first.
    """

    def __init__(self, known: Mapping[str, Sequence[str]], accuracy: float) -> None:
        self.accuracy = accuracy
        self.names = list(known)
        self.values: dict[str, list[str]] = {
            name: list(values) if values or name == CLASS else [OTHER] for name, values in known.items()
        }
        self.closed = {name for name, values in known.items() if values}
        self._index: dict[tuple[str, str], int] = {}
        self.blocks: IntArray = np.zeros((0, 2), np.int64)
        self._number()

    def _number(self) -> None:
        sizes = [len(self.values[name]) for name in self.names]
        ends = np.cumsum(sizes)
        self.blocks = np.column_stack([ends - sizes, ends]).astype(np.int64)
        self._index = {
            (name, value): int(start) + at
            for name, (start, _) in zip(self.names, self.blocks, strict=True)
            for at, value in enumerate(self.values[name])
        }
        self._prior = np.zeros(self.width)
        for start, end in self.blocks:
            self._prior[start:end] = 1.0 / max(end - start, 1)

    @property
    def width(self) -> int:
        """Columns in all."""
        return int(self.blocks[-1, 1])

    @property
    def classes(self) -> int:
        """How many classes there are; they have the first columns."""
        return int(self.blocks[0, 1])

    def prior(self) -> FloatArray:
        """Uniform distributions (A,), those of an object about which nothing is known."""
        return self._prior

    def check(self, attributes: Sequence[Mapping[str, Distribution]]) -> list[tuple[str, str]]:
        """New values of open attributes; InputError for unknown attributes and for values of closed ones."""
        fresh: dict[tuple[str, str], None] = {}
        for index, item in enumerate(attributes):
            fresh |= dict.fromkeys(self.check_one(f"objects[{index}]", item))
        return list(fresh)

    def check_one(self, where: str, attributes: Mapping[str, Distribution]) -> list[tuple[str, str]]:
        """The same of one detection."""
        fresh = []
        for name, distribution in attributes.items():
            if name not in self.values:
                raise InputError(
                    f"{where}.attributes: unknown attribute {name!r}; known are {', '.join(self.names)}"
                )
            for value in distribution:
                if value and (name, value) in self._index:
                    continue
                if name in self.closed or not isinstance(value, str) or not value:
                    raise InputError(
                        f"{where}.attributes[{name!r}]: unknown value {value!r}; "
                        f"known are {', '.join(filter(None, self.values[name]))}"
                    )
                fresh.append((name, value))
        return fresh

    def add(self, name: str, value: str) -> int:
        """A new value; returns the column it was inserted at."""
        self.values[name].append(value)
        self._number()
        return self._index[name, value]

    def likelihoods(self, attributes: Sequence[Mapping[str, Distribution]]) -> FloatArray:
        """p(what was measured | value) per detection (M, A), relative to an object about which nothing is known.

        A detector's distribution is proportional to this where its prior is uniform. It is never believed to be
        right more often than `class_accuracy`. An attribute that was not measured says nothing: 1.
        """
        out = np.ones((len(attributes), self.width))
        given = np.zeros_like(out)
        told: list[list[int]] = [[] for _ in self.names]
        for j, item in enumerate(attributes):
            for name, distribution in item.items():
                told[self.names.index(name)].append(j)
                for value, probability in distribution.items():
                    given[j, self._index[name, value]] = probability
        for rows, (start, end) in zip(told, self.blocks.tolist(), strict=True):
            if rows and end - start > 1:
                out[rows, start:end] = self._believed(given[rows, start:end])
        return out

    def _believed(self, given: FloatArray) -> FloatArray:
        """Of distributions (M, size)."""
        size = given.shape[1]
        given = given / given.sum(1, keepdims=True)
        top, level = given.max(1, keepdims=True), 1.0 / size
        sure = (top * (1.0 - LEAST) + LEAST * level > self.accuracy) & (self.accuracy > level)
        mix = np.where(sure, (top - self.accuracy) / np.maximum(top - level, 1e-12), LEAST)
        out: FloatArray = size * ((1.0 - mix) * given + mix * level)
        return out

    def distributions(self, row: FloatArray) -> dict[str, dict[str, float]]:
        """Columns of a leaf (A,) as {attribute: {value: probability}}. An attribute of which nothing is known is left
        out: none of its values is likelier than that it has another one."""
        values = row.tolist()
        out = {}
        for name, (start, end) in zip(self.names, self.blocks.tolist(), strict=True):
            told = dict(zip(self.values[name], values[start:end], strict=True))
            other = told.pop(OTHER, 0.0)
            if told and max(told.values()) > other * MORE:
                out[name] = told
        return out

    def columns(self, name: str, known: Mapping[str, float]) -> FloatArray:
        """One attribute's columns of what `distributions` tells of it; nothing is impossible."""
        given = np.array([known.get(value, 0.0) for value in self.values[name]])
        if self.values[name][0] == OTHER:
            given[0] = max(1.0 - given.sum(), 0.0)
        out: FloatArray = (given + LOWEST / len(given)) / (given.sum() + LOWEST)
        return out


Gaussian = tuple[float, float]  # Mean and variance, SI units
FLATTEST = 0.05  # Height by width of what is taken to be the flattest thing
OUTLIERS = 0.05  # Share of measurements that say nothing: of an object that is partly hidden, for one
SIDES = 3.0  # Measurements of a mover after which its extent forgets: it looks wider or narrower as it turns
UNKNOWN = -1.0  # Variance of a quantity that was never measured


class Quantities:
    """usual : {name: (mean, standard deviation)} over all objects there are; only these are taken in. `measured` :
    those of which anything was learned yet."""

    def __init__(self, usual: Mapping[str, Gaussian]) -> None:
        self.names = list(usual)
        self.measured: set[str] = set()
        self._mean = np.array([usual[name][0] for name in self.names])
        self._variance = np.array([usual[name][1] for name in self.names]) ** 2

    def small(self, name: str) -> float:
        """A small one, NaN where nothing is known: a deviation below the median, if logarithms are normal."""
        if name not in self.names:
            return float("nan")
        column = self.names.index(name)
        mean, variance = float(self._mean[column]), float(self._variance[column])
        if mean <= 0.0:
            return float("nan")
        spread = np.log1p(variance / mean**2)
        return float(mean * np.exp(-0.5 * spread - np.sqrt(spread)))

    def check(self, where: str, given: Mapping[str, Gaussian]) -> None:
        """Raises InputError for an unknown name, or for what is no Gaussian."""
        for name, value in given.items():
            if name not in self.names:
                raise InputError(
                    f"{where}.quantities: unknown quantity {name!r}; known are {', '.join(self.names)}"
                )
            try:
                mean, variance = (float(number) for number in value)
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"{where}.quantities[{name!r}] must be (mean, variance), not {value!r}"
                ) from error
            if not np.isfinite(mean) or not 0.0 <= variance < np.inf:
                raise InputError(
                    f"{where}.quantities[{name!r}]: a finite mean and a variance of at least 0 expected, got {value!r}"
                )

    def arrays(self, given: Sequence[Mapping[str, Gaussian]]) -> tuple[FloatArray, FloatArray]:
        """Means and variances (M, Q); variance `UNKNOWN` where nothing was measured."""
        values = np.zeros((len(given), len(self.names)))
        variances = np.full(values.shape, UNKNOWN)
        for row, item in enumerate(given):
            for name, (mean, variance) in item.items():
                column = self.names.index(name)
                values[row, column], variances[row, column] = mean, variance
        return values, variances

    def log_factors(
        self, leaves: Leaves, slots: IntArray, values: FloatArray, variances: FloatArray
    ) -> FloatArray:
        """How much better leaves (n,) explain measurements (M, Q) than an unknown object does, log (n, M)."""
        out = np.zeros((len(slots), len(values)))
        for q in range(len(self.names)):
            told = np.flatnonzero(variances[:, q] >= 0.0)
            if len(told) == 0:
                continue
            mean, variance = self._known(leaves, slots, q)
            z, r = values[told, q], variances[told, q] + 1e-12
            own = _log_gauss(z[None] - mean[:, None], variance[:, None] + r[None])
            any_object = _log_gauss(z - self._mean[q], self._variance[q] + r)
            ratio = np.exp(np.minimum(own - any_object[None], 50.0))
            out[:, told] += np.log((1.0 - OUTLIERS) * ratio + OUTLIERS)
        return out

    def learn(self, leaves: Leaves, slots: IntArray, values: FloatArray, variances: FloatArray) -> None:
        """Kalman update of leaves (n,) with what was measured of each (n, Q)."""
        for q in range(len(self.names)):
            told = np.flatnonzero(variances[:, q] >= 0.0)
            if len(told) == 0:
                continue
            self.measured.add(self.names[q])
            at = slots[told]
            mean, variance = self._known(leaves, at, q)
            r = variances[told, q] + 1e-12
            gain = variance / (variance + r)
            leaves.values[at, q] = mean + gain * (values[told, q] - mean)
            # Errors are not independent for ever, and what moves shows other sides.
            memory = np.where(leaves.move(at), SIDES, MEMORY)
            leaves.variances[at, q] = np.maximum((1.0 - gain) * variance, r / memory)

    def told(self, leaves: Leaves, slots: IntArray, name: str) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
        """Means (n,) of one quantity of leaves, and of which of them it was measured (n,)."""
        if name not in self.names:
            return np.zeros(len(slots)), np.zeros(len(slots), bool)
        column = self.names.index(name)
        return leaves.values[slots, column], leaves.variances[slots, column] >= 0.0

    def described(self, leaves: Leaves, slot: int) -> dict[str, Gaussian]:
        """What is known of one leaf."""
        known = leaves.variances[slot].tolist()
        if not known or max(known) < 0.0:
            return {}
        pairs = zip(self.names, leaves.values[slot].tolist(), known, strict=True)
        return {name: (mean, variance) for name, mean, variance in pairs if variance >= 0.0}

    def _known(self, leaves: Leaves, slots: IntArray, q: int) -> tuple[FloatArray, FloatArray]:
        variance = leaves.variances[slots, q]
        never = variance < 0.0
        return np.where(never, self._mean[q], leaves.values[slots, q]), np.where(
            never, self._variance[q], variance
        )


def extent(quantities: Mapping[str, Gaussian]) -> tuple[float, float] | None:
    """Width and height, m, of an object with a known diagonal "size" (and "ratio", height by width); None without."""
    if "size" not in quantities:
        return None
    ratio = max(quantities["ratio"][0], FLATTEST) if "ratio" in quantities else 1.0
    width = quantities["size"][0] / float(np.sqrt(2.0 + ratio**2))
    return width, ratio * width


def _log_gauss(offset: FloatArray, variance: FloatArray) -> FloatArray:
    result: FloatArray = -0.5 * (offset**2 / variance + np.log(2.0 * np.pi * variance))
    return result
