"""Candidates from a long history in less than linear time: nearest neighbours in a metric learned from pairs.

    embedding = shipped_model("best_2d").embedding
    index = NearestPlaces(embedding.dimension)
    index.add(embedding(signature)); index.query(embedding(signature), count=1000)

The metric is that of linear discriminants: differences within one place are made alike in all directions, and those
directions are kept in which different places differ most. The index sorts places into about √N cells around centres
and looks only into the cells nearest to the query: O(√N) per query. Cells are made anew whenever the history has
doubled, so that adding takes constant time on average; what was added since goes into the cell of its nearest centre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_points, require_count
from estimation.errors import InputError
from loop_closure.growing_array import GrowingArray

Vectors = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Embedding:
    """Linear map of signatures: matrix (d, S). Euclidean distance of mapped signatures says how unlike places are."""

    matrix: FloatArray

    @property
    def dimension(self) -> int:
        return len(self.matrix)

    def __call__(self, signature: npt.ArrayLike) -> Vectors:
        """Signature (S,) or signatures (M, S) as vectors (d,) or (M, d)."""
        return (np.asarray(signature, dtype=np.float64) @ self.matrix.T).astype(np.float32)

    def to_dict(self) -> dict[str, Any]:
        """As plain numbers, six digits of each."""
        return {"matrix": [[float(f"{value:.6g}") for value in row] for row in self.matrix]}

    @classmethod
    def from_dict(cls, content: Any) -> Embedding:
        """What `to_dict` described; InputError where it is not complete."""
        try:
            matrix = as_points("matrix", content["matrix"])
        except (KeyError, TypeError) as error:
            raise InputError(f"embedding: not complete: {error}") from error
        return cls(matrix)


class NearestPlaces:
    """Vectors that can be asked for the nearest ones to another.

    Parameters
    ----------
    dimension : d. probed : cells that a query looks into, at least; more where they hold too few.
    smallest : vectors up to which all are compared.
    """

    def __init__(self, dimension: int, probed: int = 32, smallest: int = 2000) -> None:
        self.dimension = require_count("dimension", dimension)
        self.probed, self.smallest = require_count("probed", probed), require_count("smallest", smallest)
        self._vectors, self._built = GrowingArray((dimension,), np.float32), 0
        self._centres = np.empty((0, dimension), dtype=np.float32)
        self._cells: list[list[int]] = []

    def __len__(self) -> int:
        return len(self._vectors)

    @property
    def nbytes(self) -> int:
        """Memory of the stored vectors and their places in the cells, in bytes."""
        return len(self) * (4 * self.dimension + 8) + int(self._centres.nbytes)

    def add(self, vector: npt.ArrayLike) -> int:
        """Remember a vector (d,); returns its id, counted from 0. InputError for another shape."""
        vector = np.asarray(vector, dtype=np.float32)
        if vector.shape != (self.dimension,):
            raise InputError(f"vector must have shape ({self.dimension},), not {vector.shape}")
        self._vectors.append(vector)
        if len(self) >= max(self.smallest, 2 * self._built):
            self._build()
        elif self._built:
            self._cells[int(_squares(self._centres, vector).argmin())].append(len(self) - 1)
        return len(self) - 1

    def of(self, rows: npt.NDArray[np.int64]) -> NearestPlaces:
        """An index of the vectors of these ids (K,) alone, counted anew."""
        made = NearestPlaces(self.dimension, self.probed, self.smallest)
        made._vectors = GrowingArray.of(self._vectors.rows[rows])
        if self._built:
            made._centres, made._built = self._centres, self._built
            number = np.full(len(self), -1)
            number[rows] = np.arange(len(rows))
            made._cells = [[int(k) for k in number[cell] if k >= 0] for cell in self._cells]
        return made

    def query(self, vector: npt.ArrayLike, count: int) -> npt.NDArray[np.int64]:
        """Ids of about the `count` nearest vectors, nearest first; all of them where there are fewer."""
        vector = np.asarray(vector, dtype=np.float32)
        few = not self._built or count >= len(self)
        rows = np.arange(len(self)) if few else self._near(vector, count)
        squares = _squares(self._vectors.rows[rows], vector)
        if count < len(rows):
            kept = np.argpartition(squares, count)[:count]
            rows, squares = rows[kept], squares[kept]
        return np.asarray(rows[np.lexsort((rows, squares))], dtype=np.int64)

    def _near(self, vector: Vectors, count: int) -> npt.NDArray[np.int64]:
        """Ids in the nearest cells: `probed` of them, and on until twice as many as are wanted are there."""
        order = np.argsort(_squares(self._centres, vector), kind="stable")
        found: list[int] = []
        for rank, cell in enumerate(order):
            if rank >= self.probed and len(found) >= 2 * count:
                break
            found += self._cells[cell]
        return np.array(found, dtype=np.int64)

    def _build(self) -> None:
        """Centres by a few rounds of k-means on a sample, from evenly drawn vectors: no chance in it."""
        vectors = self._vectors.rows
        cells = max(1, math.isqrt(len(self)))
        sample = vectors[:: max(1, len(self) // (40 * cells))]
        centres = sample[np.linspace(0, len(sample) - 1, cells).astype(np.int64)].copy()
        for _ in range(6):
            nearest = _nearest(centres, sample)
            sums = np.zeros((cells, self.dimension))
            np.add.at(sums, nearest, sample)
            members = np.bincount(nearest, minlength=cells)
            centres[members > 0] = (sums[members > 0] / members[members > 0, None]).astype(np.float32)
        self._centres, self._built = centres, len(self)
        self._cells = [[] for _ in range(cells)]
        for identity, cell in enumerate(_nearest(centres, vectors)):
            self._cells[cell].append(identity)


def _squares(vectors: Vectors, vector: Vectors) -> Vectors:
    """Squared distances (M,) of vectors (M, d) to one."""
    apart = vectors - vector
    return np.asarray(np.einsum("ij,ij->i", apart, apart))


def _nearest(centres: Vectors, vectors: Vectors) -> npt.NDArray[np.int64]:
    """Index of the nearest centre of each vector, (M,), in parts that fit into memory."""
    squares = np.einsum("ij,ij->i", centres, centres)
    parts = np.array_split(vectors, 1 + len(vectors) // 20_000)
    return np.concatenate([np.argmin(squares - 2.0 * part @ centres.T, axis=1) for part in parts])
