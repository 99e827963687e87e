"""The intensity (6) of a PHD filter: a Gaussian mixture whose weights add up to the expected number of targets."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray

IntArray = npt.NDArray[np.int64]


@dataclass
class Components:
    """J weighted Gaussians over (x, y, vx, vy) and what each remembers of its returns.

    `counts` (J, 2) are shape and rate of the gamma density of a target's measurement rate; `spread` (J, 2, 2)
    over `freedom` (J,) is the covariance of its returns about their centre, m².
    """

    weights: FloatArray
    means: FloatArray
    covariances: FloatArray
    labels: IntArray
    counts: FloatArray
    spread: FloatArray
    freedom: FloatArray

    def __len__(self) -> int:
        return len(self.weights)

    @classmethod
    def empty(cls) -> Components:
        """No components."""
        return cls(
            np.zeros(0),
            np.zeros((0, 4)),
            np.zeros((0, 4, 4)),
            np.zeros(0, dtype=np.int64),
            np.zeros((0, 2)),
            np.zeros((0, 2, 2)),
            np.zeros(0),
        )

    def select(self, index: npt.NDArray[np.int64] | npt.NDArray[np.bool_]) -> Components:
        """The components of an index or a mask, copied."""
        return Components(*(getattr(self, item.name)[index] for item in fields(self)))

    @staticmethod
    def join(parts: list[Components]) -> Components:
        """All components of several mixtures."""
        return Components(
            *(np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(Components))
        )


def shift_components(components: Components, motion: FloatArray) -> None:
    """Moves components with their frame, by x, y and yaw (3,)."""
    c, s = np.cos(motion[2]), np.sin(motion[2])
    turn = np.array([[c, -s], [s, c]])
    both = np.kron(np.eye(2), turn)
    components.means = components.means @ both.T + np.array([*motion[:2], 0.0, 0.0])
    components.covariances = both @ components.covariances @ both.T
    components.spread = turn @ components.spread @ turn.T
