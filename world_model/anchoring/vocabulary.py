"""Discrete attributes as numbers: which column of a leaf stands for which value, and what a detection says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from estimation.checks import FloatArray
from estimation.errors import InputError
from world_model.anchoring.leaves import IntArray
from world_model.evidence import Distribution

LEAST = 0.01  # of a detector's probability goes to values it does not name or excludes


class Vocabulary:
    """Values of each attribute, side by side in columns; closed lists refuse other values, open ones grow.

    blocks (K, 2) : first column and column after the last of each attribute, classes first.
    """

    def __init__(self, known: Mapping[str, Sequence[str]], accuracy: float) -> None:
        self.accuracy = accuracy
        self.names = list(known)
        self.values: dict[str, list[str]] = {name: list(values) for name, values in known.items()}
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
                if (name, value) in self._index:
                    continue
                if name in self.closed or not isinstance(value, str) or not value:
                    raise InputError(
                        f"{where}.attributes[{name!r}]: unknown value {value!r}; "
                        f"known are {', '.join(self.values[name])}"
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
        """Columns of a leaf (A,) as {attribute: {value: probability}}; attributes without values are left out."""
        values = row.tolist()
        return {
            name: dict(zip(self.values[name], values[start:end], strict=True))
            for name, (start, end) in zip(self.names, self.blocks.tolist(), strict=True)
            if end > start
        }
